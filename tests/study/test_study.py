"""What a study says of its members: statuses from their files, counts, and the tables that compare them."""

import json
from types import SimpleNamespace

import pytest

from greybox.study.batch import _Display, require_distinct
from greybox.study.study import Study, StudyMember, read_study
from greybox.study.study_folder import member_folder, read_index, read_json, write_index

ANSWER = {
    "criterion": "relative error",
    "delay": "exact",
    "rule": "Sobol",
    "checksum": "1f",
    "verdict": {"grade": "good"},
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
    own = write_index(folder, list(answers))
    for name, answer in answers.items():
        if answer is not None:
            (member_folder(folder, own[name]) / "answer.json").write_text(json.dumps(answer))
    return own


def test_a_member_is_done_failed_or_unfinished_by_what_its_folder_holds(tmp_path):
    own = study_of(tmp_path, fast=ANSWER, broken={"error": "no start"}, waiting=None)
    (member_folder(tmp_path, own["waiting"]) / "runs-000003-7.h5").touch()
    (member_folder(tmp_path, own["broken"]) / "runs-000001-4.h5").touch()
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
    with pytest.raises(FileNotFoundError):
        study["waiting"].fit  # noqa: B018


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
    assert failed == "Failed:\n  broken: no start"
    none = Study(tmp_path, ())
    assert "0 members: none" in repr(none)
    assert "Failed" not in str(none)
    assert repr(StudyMember("a", tmp_path, "done", "", 1, {})) == "<StudyMember a, done, 1 run>"


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
    with pytest.raises(ValueError, match=r"answer\.json is damaged: delete it"):
        read_study(tmp_path)


def test_folders_are_numbered_named_after_their_members_and_kept(tmp_path):
    long = "a" * 80
    own = study_of(tmp_path, **{"pitch, 5°": None, long: None, "..": None})
    assert own == {"pitch, 5°": "001-pitch-5", long: f"002-{'a' * 60}", "..": "003-"}
    again = write_index(tmp_path, ["yaw", "pitch, 5°"])
    assert again == {**own, "yaw": "004-yaw"}
    assert read_index(tmp_path) == again
    assert all(member_folder(tmp_path, folder).is_dir() for folder in again.values())


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"format": "other"},
            "is not the index of a study: give a folder that greybox batch wrote",
        ),
        ({"layout": "1"}, "is not the index of a study"),
        ({"layout": 2}, "has layout 2 and this version reads up to 1: update greybox"),
        ({"members": {}}, "is damaged: restore it"),
        ({"members": [3]}, "is damaged"),
        ({"members": [{"name": "a"}]}, "is damaged"),
        ({"members": [{"folder": "001-a"}]}, "is damaged"),
        ({"members": [{"name": 1, "folder": "001-a"}]}, "is damaged"),
        ({"members": [{"name": "a\u001b[0m", "folder": "001-a"}]}, "is damaged"),
        ({"members": [{"name": "a", "folder": "01-a"}]}, "is damaged"),
        ({"members": [{"name": "a", "folder": "001-a/b"}]}, "is damaged"),
    ],
)
def test_an_index_that_is_none_is_refused(tmp_path, change, said):
    index = {
        "format": "greybox study",
        "layout": 1,
        "members": [{"name": "a", "folder": "0001-a.b_c"}],
    } | change
    (tmp_path / "study.json").write_text(json.dumps(index))
    with pytest.raises(ValueError, match=said):
        read_index(tmp_path)


def test_a_file_that_is_no_object_is_damaged(tmp_path):
    for content in (b"[]", b"{", b"\xff{}", b"[" * 100_000):
        (tmp_path / "one.json").write_bytes(content)
        with pytest.raises(ValueError, match=r"one\.json is damaged"):
            read_json(tmp_path / "one.json")
    (tmp_path / "one.json").write_text("{}")
    assert read_json(tmp_path / "one.json") == {}


def test_progress_counts_what_is_done_and_what_failed():
    """Of three members: shares of a member at hand add up to less than it."""
    said = []
    bar = SimpleNamespace(
        total=3, n=0.0, set_description_str=lambda text, refresh: said.append(text)
    )

    def update(by):
        bar.n += by

    bar.update = update
    display = _Display(bar)
    report = display.begin("pitch")
    report(1, 4)
    early = bar.n
    report(4, 4)
    assert 0 < early < bar.n <= 1
    display.end(failed=True)
    assert bar.n == 1
    display.begin("yaw")(1, 1)
    assert 1 < bar.n <= 2
    display.end(failed=False)
    assert bar.n == 2
    display.begin("roll")(0, 2)
    assert said == [
        "0 of 3 done; pitch: 1 of 4 starts",
        "0 of 3 done; pitch: 4 of 4 starts",
        "1 of 3 done, 1 failed; yaw: 1 of 1 start",
        "2 of 3 done, 1 failed; roll: 0 of 2 starts",
    ]


def test_members_are_named_apart():
    names = [SimpleNamespace(name=name) for name in ("a", "b", "a")]
    require_distinct(names[:2])
    with pytest.raises(ValueError, match="2 members have the name 'a'"):
        require_distinct(names)
