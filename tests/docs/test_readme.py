"""What the README and the guide show runs.

Tests/problems holds the generated tables against the fits.
"""

import operator
import re

import numpy as np
import pytest
from command_line import run
from PIL import Image
from readme_blocks import NUMBER, PICTURE, README, draw_picture

import greybox as gb
from greybox.cli.study_file import read_study_file
from greybox.problems import pitch_hover

TEXT = README.read_text(encoding="utf-8")


PAGES = [README, *sorted((README.parent / "docs").rglob("*.md"))]
RUNNING = [
    page
    for page in PAGES
    if "```python\n" in page.read_text(encoding="utf-8")
    and page.stem != "gallery"  # the build of the documentation runs it, to show its figures
]


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("page", RUNNING, ids=lambda page: page.stem)
def test_the_examples_run(page, tmp_path, monkeypatch, capsys, request):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    names = {"__name__": "example"}
    if page is not README and not any("misfit" in block for block in blocks):
        request.getfixturevalue("unjudged")
    for block in blocks:
        for package in re.findall(r"^import (emcee|pypesto)$", block, re.MULTILINE):
            pytest.importorskip(package)  # nothing but the examples of samplers needs it
        exec(compile(block, page.name, "exec"), names)
    if page is README:
        assert "rate per control" in capsys.readouterr().out
        assert (tmp_path / "roll.h5").exists()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text) + re.findall(r"`(benchmarks/[\w/.]+)`", text):
        if not target.startswith("http"):
            base = README.parent if target.startswith("benchmarks/") else page.parent
            assert (base / target).exists() or target == "../commands.md", (
                target
            )  # conf.py writes it


def test_the_picture_is_what_the_command_draws(tmp_path):
    """Its size, the texts of its axes, and the width of its bands.

    Other pixels depend on fonts, and matplotlib 3.10 rounds the width to one more.
    """
    assert f"]({PICTURE.relative_to(README.parent).as_posix()})" in TEXT
    assert PICTURE.stat().st_size < 150_000
    draw_picture(tmp_path / "new.png")
    with Image.open(PICTURE) as kept, Image.open(tmp_path / "new.png") as new:
        assert kept.size == pytest.approx(new.size, abs=1)
        texts = [
            NUMBER.sub("#", image.text["Description"]) for image in (kept, new)
        ]  # as many starts agree as may
        assert texts[0] == texts[1], "run `python tests/support/readme_blocks.py`"
        areas = [np.array(image.convert("RGB")) @ [-1, 0, 1] > 25 for image in (kept, new)]
        assert areas[0].sum() > 50_000  # pixels of a pale blue
        assert areas[0].sum() == pytest.approx(areas[1].sum(), rel=0.03)


NOTEBOOKS = sorted((README.parent / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize(
    "page", [*PAGES, README.with_name("CONTRIBUTING.md"), *NOTEBOOKS], ids=lambda page: page.stem
)
def test_the_names_are_there(page):
    for name in re.findall(r"`gb\.([a-z_.A-Z]+)", page.read_text(encoding="utf-8")):
        operator.attrgetter(name.rstrip("."))(gb)


def test_the_commands_are_there():
    for command in ("run", "test"):
        assert re.search(rf"<!-- {command} -->\n```bash\n.+\n```", TEXT)


@pytest.mark.usefixtures("few_draws")
def test_the_commands_for_a_log_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "problems").symlink_to(README.parent / "problems")
    commands = re.findall(r"^\$ greybox (.+?) *(?:#.*)?$", TEXT, re.MULTILINE)
    assert len(commands) == 3
    for command in commands:
        status, out, _ = run(capsys, *command.split())
        assert status == 0
    assert "sitl_pitch_fit.html" in out
    assert gb.load("sitl_pitch_fit.h5").misfit.explains


def test_the_study_file_is_read(tmp_path):
    page = README.parent / "docs" / "guide" / "many_fits.md"
    (block,) = re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "study.toml").write_text(block)
    gb.data.write_response(pitch_hover.data(), tmp_path / "pitch.csv")
    members = read_study_file(tmp_path / "study.toml")
    assert len(members) == 2 * 2 * 2 * 2 + 2
    assert {member.starts for member in members} == {200}
    assert members[-1].problem.parameters["T_delay"].start == 0.0042
