"""What a study says of its members: statuses from their files, counts, and the tables that compare them."""

from types import SimpleNamespace

import numpy as np
import pytest

from greybox.engine.solve.runs import Outcome
from greybox.workflows.study.batch import require_distinct
from greybox.workflows.study.members import StudyMember, add_members
from greybox.workflows.study.stored_runs import StoredRuns
from greybox.workflows.study.study import Study, read_study

ANSWER = {
    "criterion": "relative error",
    "delay": "exact",
    "rule": "Sobol",
    "checksum": "1f",
    "verdict": {"grade": "good"},
    "misfit": {"explains": False},
    "model": ["Lag"],
    "data": ["pitch"],
    "starts": 20,
    "converged": 18,
    "agreeing": 17,
    "minima": 2,
    "cost": 1.25,
    "warnings": ["one", "two"],
    "estimate": {"K": 2.0, "T": 0.5, "d": 0.25},
    "derived": {"ratio": 4.0, "open": None},
    "standard_error": {"K": 0.1, "T": None, "d": 0.0, "ratio": 0.2, "open": None},
}


def study_of(folder, **answers):
    """A study on disk, of members that have such an answer, or none yet."""
    add_members(folder, list(answers))
    runs = StoredRuns(folder)
    for name, answer in answers.items():
        if answer is not None:
            runs.begin(name)
            runs.finish(answer)
    runs.write()


def test_a_model_that_explains_on_a_condition_only_is_not_said_to_explain(tmp_path):
    misfits = {"wrong": {"explains": False}, "right": {"explains": True, "is_conditional": False}}
    misfits["large errors"] = {"explains": True, "is_conditional": True}
    study_of(tmp_path, **{name: ANSWER | {"misfit": misfit} for name, misfit in misfits.items()})
    rows = {row["member"]: row["explains"] for row in read_study(tmp_path).table}
    assert rows == {"wrong": False, "right": True, "large errors": None}


def test_a_member_is_done_failed_or_unfinished_by_what_is_on_disk(tmp_path):
    study_of(tmp_path, fast=ANSWER, broken={"error": "no start"}, waiting=None)
    for name, count in (("broken", 4), ("waiting", 7)):
        runs = StoredRuns(tmp_path, name)
        for number in range(count):
            runs.add(number, np.zeros(1), Outcome(np.zeros(1), "done", 1, 0.0, True))
        runs.write()
    study = read_study(tmp_path)
    assert [(m.name, m.status, m.error, m.runs) for m in study.members] == [
        ("fast", "done", "", 20),
        ("broken", "failed", "no start", 4),
        ("waiting", "unfinished", "", 7),
    ]
    assert study["broken"] is study.members[1]
    assert [study.count(status) for status in ("done", "failed", "unfinished")] == [1, 1, 1]
    with pytest.raises(
        KeyError, match="the study has no member 'other'; it has fast, broken, waiting"
    ):
        study["other"]
    assert study["waiting"].fit is None
    assert "continues" in study["waiting"].reason


def test_members_with_the_same_quantities_are_compared_in_one_table(tmp_path):
    other = ANSWER | {
        "standard_error": {"K": 0.3},
        "estimate": {"K": 3.0},
        "cost": None,
        "warnings": [],
    }
    study_of(
        tmp_path,
        fast=ANSWER,
        slow=ANSWER | {"cost": 2.5},
        alone=other,
        broken={"error": "no start"},
        waiting=None,
    )
    text = str(read_study(tmp_path))
    title, overview, first, second, failed = text.split("\n\n")
    assert title.endswith("5 members: 3 done, 1 failed, 1 unfinished")
    rows = {line.split()[0]: line.split() for line in overview.splitlines()}
    assert rows["fast"] == [
        "fast",
        "False",
        "done",
        "relative",
        "error",
        "exact",
        "20",
        "18",
        "17",
        "2",
        "1.25",
        "2",
    ]
    assert rows["slow"][-2:] == ["2.5", "2"]
    assert rows["alone"][-2:] == ["-", "0"]
    assert rows["broken"] == ["broken", "failed", "0"]
    assert rows["waiting"] == ["waiting", "unfinished", "0"]
    header, *lines = [line.split() for line in first.splitlines() if not set(line) <= set("-─ ")]
    assert header == ["member", "K", "T", "d", "ratio", "open"]
    cells = ["2.00", "±", "0.10", "0.5", "0.25", "4.00", "±", "0.20", "-"]
    assert lines == [["fast", *cells], ["slow", *cells]]
    assert second.splitlines()[-1].split() == ["alone", "3.00", "±", "0.30"]
    assert failed.splitlines()[-1].split() == ["1", "broken", "no", "start"]
    none = Study(tmp_path, ())
    assert "0 members: none" in repr(none)
    assert none.failures == ""
    assert repr(StudyMember(tmp_path, 1, "a", {}, 1)) == "<StudyMember a, unfinished, 1 run>"


@pytest.mark.parametrize(
    "change",
    [
        {"starts": "many"},
        {"standard_error": {"x": 1.0}},
        {"warnings": 3},
        {"rule": 4},
        {"checksum": None},
        {"verdict": {"grade": 1}},
        {"model": [1]},
        {"data": [None]},
        {"criterion": ["relative"]},
        {"cost": "low"},
    ],
)
def test_an_answer_with_other_kinds_of_values_is_damaged(tmp_path, change):
    study_of(tmp_path, fast=ANSWER | change)
    with pytest.raises(ValueError, match="answer of 'fast'"):
        read_study(tmp_path)


def test_members_are_named_apart():
    problem = SimpleNamespace(parts=("data",))
    names = [SimpleNamespace(name=name, problem=problem) for name in ("a", "b", "a")]
    require_distinct(names[:2])
    with pytest.raises(ValueError, match="2 members have the name 'a'"):
        require_distinct(names)
