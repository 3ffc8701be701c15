"""The study of every structure of the paper: `greybox batch paper`."""

from dataclasses import replace

import pytest

import greybox as gb
from greybox.problems import (
    _paper_study as paper,
    pitch_5deg,
    pitch_hover,
    roll_hover,
    rotors,
    yaw_hover,
)

pytestmark = pytest.mark.usefixtures("unjudged_file")


def test_every_structure_is_fitted_by_every_criterion_with_both_delays():
    members = paper.members()
    assert len(members) == len({member.name for member in members}) == 26 * 3 * 2
    equations = {name.rpartition(" ")[2] for name in paper.problems()}
    assert equations == {
        "(2.5)",
        "(2.6)",
        "(2.7)",
        "(2.8)",
        "(2.9)",
        "(2.10)",
        "(2.12)",
        "(2.13)",
        "(4.21)",
        "(4.25)",
        "(4.34)",
    }


def test_the_minima_are_those_of_the_problems_and_stand_beside_the_paper(tmp_path):
    # The relative error of a rate is that of its angle.
    minima = {
        "rotors (4.21)": rotors,
        "roll (4.25)": roll_hover,
        "pitch (4.25)": pitch_hover,
        "pitch 5 deg (4.25)": pitch_5deg,
        "yaw (4.34)": yaw_hover,
    }
    exact = [member for member in paper.members(4) if member.name.endswith(", exact")]
    relative = {
        member.name.removesuffix(", relative-error, exact"): member
        for member in exact
        if "relative-error" in member.name
    }
    chosen = [relative[name] for name in (*minima, "roll (2.5)", "roll (2.6)")]
    # The table needs the other members of published structures, whose minima do not matter here.
    others = [
        replace(member, starts=1)
        for member in exact
        if member.name.partition(", ")[0] in paper.PUBLISHED and member not in chosen
    ]
    study = gb.batch([*chosen, *others], tmp_path, progress=False)
    assert study.count("done") == len(study.members) == 8 * 3 + 2

    def cost(name):
        return study[relative[name].name].answer["cost"]

    for name, problem in minima.items():
        assert cost(name) == pytest.approx(problem.minimum, rel=1e-4)
    assert cost("roll (2.5)") == pytest.approx(cost("roll (2.6)"), rel=1e-6)

    lines = paper.beside_the_paper(study).splitlines()
    (first,) = (k for k, line in enumerate(lines) if line.startswith("pitch (4.25), (4.28)"))
    assert lines[first].split()[3:8] == ["a1", "-14.61", "-13.6", "±", "1.3"]
    assert lines[first + 4].split()[2:4] == ["0.5866", "0.5592"]
