"""What the README shows runs, and its tables are what the code gives."""

import operator
import re

import pytest
from PIL import Image
from readme_blocks import PICTURE, README, draw_picture, written

import greybox as gb
from greybox.cli.study_file import read_study_file
from greybox.problems import pitch_hover

TEXT = README.read_text(encoding="utf-8")
NUMBER = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?")


def test_the_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {"__name__": "readme_example"})
    assert "rate per control" in capsys.readouterr().out
    assert (tmp_path / "roll.h5").exists()


def test_the_tables_are_what_the_code_gives():
    new = written(TEXT)
    assert NUMBER.sub("#", new) == NUMBER.sub("#", TEXT), "run `python tests/support/readme_blocks.py`"
    # The yaw problem's values lie in a flat valley: their last digits depend on the machine.
    shown, found = ([float(n) for n in NUMBER.findall(text)] for text in (TEXT, new))
    assert found == pytest.approx(shown, rel=5e-3, abs=1e-6), "run `python tests/support/readme_blocks.py`"


def test_the_picture_is_what_the_command_draws(tmp_path):
    """Its size and the texts of its axes; pixels depend on fonts, and matplotlib 3.10 rounds the width to one more."""
    assert f"]({PICTURE.relative_to(README.parent).as_posix()})" in TEXT
    assert PICTURE.stat().st_size < 150_000
    draw_picture(tmp_path / "new.png")
    with Image.open(PICTURE) as kept, Image.open(tmp_path / "new.png") as new:
        assert kept.size == pytest.approx(new.size, abs=1)
        assert kept.text["Description"] == new.text["Description"], "run `python tests/support/readme_blocks.py`"


@pytest.mark.parametrize("file", ["README.md", "CONTRIBUTING.md"])
def test_the_names_are_there(file):
    for name in re.findall(r"`gb\.([a-z_.A-Z]+)", (README.parent / file).read_text(encoding="utf-8")):
        operator.attrgetter(name.rstrip("."))(gb)


def test_the_new_names_in_the_changelog_are_there():
    text = (README.parent / "CHANGELOG.md").read_text(encoding="utf-8")
    names = re.findall(r"^\| `gb\.[^|]*\| `gb\.([\w.]+)", text, re.MULTILINE)
    assert len(names) > 40
    for name in names:
        operator.attrgetter(name)(gb)


def test_the_commands_are_there():
    for heading in ("Run it", "Test it"):
        section = TEXT.split(f"## {heading}\n")[1].split("\n## ")[0]
        assert re.search(r"```bash\n.+\n```", section)


def test_the_study_file_is_read(tmp_path):
    (block,) = re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL)
    (tmp_path / "study.toml").write_text(block)
    gb.data.write_response(pitch_hover.data(), tmp_path / "pitch.csv")
    members = read_study_file(tmp_path / "study.toml")
    assert len(members) == 2 * 2 * 2 * 2 + 2
    assert {member.starts for member in members} == {200}
    assert members[-1].problem.parameters["T_delay"].start == 0.0042
