"""`greybox report`: a page of saved results."""

import json
import re
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from command_line import OWN, RECORD, refused, run

import greybox as gb
from greybox.workflows.study.members import StudyMember

QUICK = "--starts", "4"


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A result, and a study of three members, one of which failed."""
    from greybox.problems import roll_hover

    folder = tmp_path_factory.mktemp("results")
    gb.save(gb.fit(roll_hover.problem(), starts=4, progress=False), folder / "roll.h5")
    bad = roll_hover.problem().with_(name="bad", constraints=[lambda p: p.a2 - 1e6])
    members = [
        gb.study.Member(roll_hover.problem(), starts=4, name="good one"),
        # Of one structure: a comparison of structures would read all members.
        gb.study.Member(
            roll_hover.problem().with_(criterion=gb.MagnitudePhase()), starts=4, name="worse one"
        ),
        gb.study.Member(bad, starts=1, name="bad one"),
    ]
    gb.batch(members, folder / "study", progress=False)
    return folder


def test_a_result_becomes_a_page(capsys, results, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, _ = run(capsys, "report", results / "roll.h5")
    assert status == 0
    assert out.startswith("wrote roll.html")
    text = (tmp_path / "roll.html").read_text(encoding="utf-8")
    assert "Tilt with 4 free parameters" in text
    assert "exists" in refused(capsys, "report", results / "roll.h5")
    assert "end it in .html" in refused(capsys, "report", results / "roll.h5", "--out", "page.pdf")
    assert "no file" in refused(capsys, "report", "missing.h5", "--out", "missing.html")
    assert not (tmp_path / "missing.html").exists()


def test_results_and_studies_stand_side_by_side(capsys, results, tmp_path):
    page = tmp_path / "all.html"
    status, out, _ = run(
        capsys, "report", results / "roll.h5", results / "study", "--out", page, "--json"
    )
    assert status == 0
    names = [str(results / name) for name in ("roll.h5", "study")]
    assert json.loads(out)["results"] == names
    assert json.loads(out)["bytes"] == page.stat().st_size
    text = page.read_text(encoding="utf-8")
    assert "4 results side by side" in text
    assert "no start converged" in text


def test_of_a_large_study_the_first_members_are_read_and_drawn(
    capsys, results, tmp_path, monkeypatch
):
    monkeypatch.setattr(import_module("greybox.reporting.html_report.report"), "DETAILED", 1)
    loaded = []
    fit = StudyMember.fit.fget
    monkeypatch.setattr(
        StudyMember, "fit", property(lambda member: loaded.append(member.name) or fit(member))
    )
    page = tmp_path / "study.html"
    assert run(capsys, "report", results / "study", "--out", page)[0] == 0
    text = page.read_text(encoding="utf-8")
    worse = gb.study.read_study(results / "study")["worse one"].answer
    assert f"{worse['cost']:.6g}" in text  # the tables have the numbers of all members
    assert re.search(rf"\b{int(worse['estimate']['a4'])}[.\d]* ±", text)
    assert "Below are details of 1 result." in text
    assert loaded == ["good one"]


def test_profiles_are_in_the_page(capsys, results, tmp_path):
    fit = gb.load(results / "roll.h5")
    gb.save(replace(fit, profiles=gb.profile(fit, ["a1"])), tmp_path / "roll.h5")
    page = tmp_path / "roll.html"
    assert run(capsys, "report", tmp_path / "roll.h5", "--out", page)[0] == 0
    text = page.read_text(encoding="utf-8")
    assert str(gb.load(tmp_path / "roll.h5").profiles["a1"]) in text
    assert "Profile of a1" in text


def test_a_model_of_ones_own_is_drawn_where_its_file_is_given(capsys, own, tmp_path):
    file = own(OWN)
    assert run(capsys, "fit", file, *QUICK, "--out", "own.h5")[0] == 0
    run(capsys, "report", "own.h5", "--out", "without.html")
    without = (tmp_path / "without.html").read_text(encoding="utf-8")
    assert f"<code>greybox fit {file} --starts 4 --out own.h5</code>" in without
    assert "The formula is not available: the model Lag" in without
    assert "Bode diagram" in without
    run(capsys, "report", "own.h5", "--model", file, "--out", "with.html")
    assert "return p.K / (p.T * s + 1)" in (tmp_path / "with.html").read_text(encoding="utf-8")


def test_held_out_records_are_predicted(capsys, own, tmp_path):
    text = RECORD.replace(
        "settings =",
        'def slow():\n    return gb.Problem(Lag(), problem().data, fixed={"T": 1.0})\n\nsettings =',
    )
    file = own(text)
    for name in ("problem", "slow"):
        assert run(capsys, "fit", f"{file}:{name}", "--starts", "2", "--out", f"{name}.h5")[0] == 0
    time = np.arange(150) / 50
    u = np.sin(5 * time)
    lines = [
        f"{t:.2f},{a:.6f},{b:.6f}"
        for t, a, b in zip(time, u, 0.3 * np.sin(5 * time - 1), strict=True)
    ]
    (tmp_path / "flight.csv").write_text("\n".join(["time,u,y [m]", *lines]))
    both = ("problem.h5", "slow.h5", "--model", file)
    assert run(capsys, "report", *both, "--held-out", "flight.csv", "--out", "held.html")[0] == 0
    page = (tmp_path / "held.html").read_text(encoding="utf-8")
    assert "held-out" in page
    assert "Time history, flight" in page
    compared = run(capsys, "compare", *both, "--held-out", "flight.csv", "--json")[1]
    with_held_out = gb.compare(
        *(gb.load(name, models=[file]) for name in both[:2]),
        records=gb.prepare(gb.read("flight.csv"), {"u": "u", "y": "y"}),
        labels=["problem", "slow"],
    )
    assert json.loads(compared)["statements"] == list(with_held_out.statements)
    assert any("held-out" in statement for statement in with_held_out.statements)
    alone = refused(
        capsys, "report", "slow.h5", "--model", file, "--held-out", "flight.csv", "--out", "x.html"
    )
    assert "give at least two" in alone


def test_a_page_names_its_author(capsys, results, tmp_path):
    page = tmp_path / "page.html"
    run(capsys, "report", results / "roll.h5", "--out", page, "--author", "A. Pilot")
    assert "A. Pilot" in page.read_text()
