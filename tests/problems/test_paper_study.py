"""The study of every structure of the paper: `greybox batch paper`."""

from dataclasses import replace

import pytest

import greybox as gb
from greybox.problems import _paper_study as paper
from greybox.problems import pitch_5deg, pitch_hover, roll_hover, rotors, yaw_hover


def test_every_structure_is_fitted_by_every_criterion_with_both_delays_from_every_seed():
    members = paper.members()
    assert len(members) == len({member.name for member in members}) == 22 * 3 * 2 * 2
    equations = {name.rpartition(" ")[2] for name in paper.problems()}
    assert equations == {
        "(2.5)",
        "(2.6)",
        "(2.7)",
        "(2.8)",
        "(2.9)",
        "(2.10)",
        "(2.12)",
        "(4.21)",
        "(4.25)",
        "(4.34)",
    }


def test_the_minima_are_those_of_the_problems(tmp_path):
    # The relative error of a rate is that of its angle.
    known = {
        "rotors (4.21)": rotors,
        "roll (4.25)": roll_hover,
        "pitch (4.25)": pitch_hover,
        "pitch 5 deg (4.25)": pitch_5deg,
        "yaw (4.34)": yaw_hover,
    }
    tables = ("roll", "pitch", "pitch 5 deg")
    wanted = [*known, *(f"{table} ({equation})" for table in tables for equation in ("2.5", "2.6"))]
    members = {
        member.name.removesuffix(", relative-error, exact, seed 0"): member
        for member in paper.members()
    }
    few = [replace(members[name], starts=8) for name in wanted]
    study = gb.batch(few, tmp_path, progress=False)
    assert study.count("done") == len(wanted)

    def cost(name):
        return study[members[name].name].answer["cost"]

    for name, problem in known.items():
        assert cost(name) == pytest.approx(problem.minimum, rel=1e-4)
    for table in tables:
        assert cost(f"{table} (2.5)") == pytest.approx(cost(f"{table} (2.6)"), rel=1e-6)
