"""The store of a study: runs come back to the last bit, and damage is refused in a sentence."""

import sqlite3
import warnings
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from greybox.engine.solve.run_storage import RunStorageError
from greybox.engine.solve.runs import IMPROVED, Outcome
from greybox.workflows.study.database import DATABASE
from greybox.workflows.study.members import add_members, read_members
from greybox.workflows.study.stored_runs import UNWRITTEN, StoredRuns, folder_beside, runs_beside
from greybox.workflows.study.study_lock import LOCK, locked

START = np.array([0.1, 1 / 3])
NODES = (np.array([[0.1, -0.0, np.nan], [np.inf, 1e-320, 2.0]]), np.ones((2, 0)))
PLAIN = Outcome(np.array([1.0, 2.0]), "Solve_Succeeded", 3, 0.5, True, stage=IMPROVED)
WHOLE = Outcome(np.array([3.0, np.pi]), "stagnated", 9, 1.5, False, 2.5, np.array([1.0, 3]), NODES)


def stored(folder, *outcomes):
    """The runs of a member, on disk."""
    runs = StoredRuns(folder, "fit")
    runs.stored("a problem")
    for number, outcome in enumerate(outcomes):
        runs.add(number, START + number, outcome)
    runs.write()
    return runs


def write_answer(folder, answer, fit=b""):
    runs = StoredRuns(folder, "fit")
    runs.finish(answer, fit)
    runs.write()


def require_same(outcome, wanted):
    for name in ("status", "iterations", "seconds", "converged", "stage"):
        assert getattr(outcome, name) == getattr(wanted, name)
    assert_array_equal(outcome.estimate, wanted.estimate)
    assert_array_equal(outcome.cost, wanted.cost)
    assert (outcome.signature is None) == (wanted.signature is None)
    assert wanted.signature is None or np.array_equal(outcome.signature, wanted.signature)
    assert (outcome.nodes is None) == (wanted.nodes is None)
    for array, states in zip(outcome.nodes or (), wanted.nodes or (), strict=True):
        assert array.shape == states.shape
        assert array.tobytes() == states.tobytes()


def test_runs_come_back_to_the_last_bit(tmp_path):
    stored(tmp_path, PLAIN, WHOLE)
    runs = StoredRuns(tmp_path, "fit")
    known = runs.stored("a problem")
    assert sorted(known) == [0, 1]
    for number, wanted in enumerate((PLAIN, WHOLE)):
        start, outcome = known[number]
        assert_array_equal(start, START + number)
        require_same(outcome, wanted)
    assert runs.count == len(known) == 2
    assert 7 not in known


def test_a_run_that_is_made_again_replaces_the_first(tmp_path):
    stored(tmp_path, PLAIN, PLAIN)
    stored(tmp_path, WHOLE)
    known = StoredRuns(tmp_path, "fit").stored("a problem")
    require_same(known[0][1], WHOLE)
    require_same(known[1][1], PLAIN)


def test_runs_that_took_long_or_are_old_are_written(tmp_path, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(
        "greybox.workflows.study.stored_runs.time", SimpleNamespace(monotonic=lambda: now[0])
    )
    runs = stored(tmp_path)
    runs.add(0, START, replace(PLAIN, seconds=0.6 * UNWRITTEN))
    now[0] += 0.9 * UNWRITTEN
    runs.write_due()
    assert runs.count == 0
    runs.add(1, START, replace(PLAIN, seconds=0.5 * UNWRITTEN))  # together they took long
    assert runs.count == 2
    runs.add(2, START, replace(PLAIN, seconds=0.0))
    now[0] += 1.1 * UNWRITTEN
    runs.write_due()
    assert runs.count == 3


def test_runs_that_are_removed_are_gone(tmp_path):
    runs = stored(tmp_path, PLAIN, WHOLE)
    runs.remove()
    assert runs.count == 0
    assert StoredRuns(tmp_path, "fit").stored("another problem") == {}


def test_runs_of_another_problem_are_refused(tmp_path):
    stored(tmp_path, PLAIN)
    with pytest.raises(RunStorageError, match="belong to another problem"):
        StoredRuns(tmp_path, "fit").stored("another problem")


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE runs SET run = replace(run, 'Solve', 'Solvd')",
        "UPDATE runs SET run = 3",
        "UPDATE runs SET run = NULL",
        "UPDATE runs SET checksum = NULL",
    ],
)
def test_a_changed_run_is_refused(tmp_path, statement):
    stored(tmp_path, PLAIN)
    change(tmp_path, statement)
    with pytest.raises(RunStorageError, match=f"{DATABASE} is damaged"):
        StoredRuns(tmp_path, "fit").stored("a problem")[0]


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("UPDATE members SET answer = '[]'", "is damaged"),
        ("UPDATE members SET fit = ''", "is damaged"),
        ("UPDATE members SET checksum = 5", "is damaged"),
        ("DROP TABLE members", "is damaged"),
        ("ALTER TABLE runs RENAME TO music", "is damaged or not a study"),
    ],
)
def test_a_changed_study_is_refused(tmp_path, statement, message):
    stored(tmp_path, PLAIN)
    write_answer(tmp_path, {"cost": 1.0})
    change(tmp_path, statement)
    with pytest.raises(ValueError, match=message):
        read_members(tmp_path)


def test_a_study_of_a_later_version_is_refused_and_not_mended(tmp_path):
    stored(tmp_path, PLAIN)
    change(tmp_path, "PRAGMA application_id = 9")
    assert read_members(tmp_path)[0].runs == 1  # the tables are the same: the number is damaged
    change(tmp_path, "ALTER TABLE runs ADD COLUMN worker")
    whole = (tmp_path / DATABASE).read_bytes()
    for read in (read_members, mended):
        with pytest.raises(ValueError, match="another version of greybox: update"):
            read(tmp_path)
    assert (tmp_path / DATABASE).read_bytes() == whole


def test_a_cut_or_overwritten_database_is_refused(tmp_path):
    stored(tmp_path, PLAIN, WHOLE)
    path = tmp_path / DATABASE
    whole = path.read_bytes()
    page = 1024
    overwritten = whole[:page] + b"\xff" * (len(whole) - page)
    for damaged in (whole[: 2 * page + 8], b"\xff" * len(whole), overwritten):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=f"{DATABASE} is damaged"):
            read_members(tmp_path)


def test_what_is_damaged_is_removed_and_the_rest_kept(tmp_path):
    stored(tmp_path, PLAIN, WHOLE, PLAIN)
    write_answer(tmp_path, {"error": "none"})
    change(tmp_path, "UPDATE runs SET run = replace(run, 'Solve', 'Solvd') WHERE number = 2")
    change(tmp_path, "UPDATE runs SET number = 7 WHERE number = 1")
    change(tmp_path, "UPDATE members SET answer = answer || 'x'")
    runs, answer = mended(tmp_path)
    assert runs.startswith("fit: removed 2 damaged runs;")
    assert answer.startswith("fit: removed 1 damaged answer;")
    assert not mended(tmp_path)
    known = StoredRuns(tmp_path, "fit").stored("a problem")
    assert sorted(known) == [0]
    require_same(known[0][1], PLAIN)
    assert read_members(tmp_path)[0].status == "unfinished"


def test_a_changed_key_of_the_problem_costs_the_runs_of_its_member(tmp_path):
    stored(tmp_path, PLAIN)
    change(tmp_path, "UPDATE members SET fingerprint = 'a problen'")
    assert len(mended(tmp_path)) == 1
    assert not StoredRuns(tmp_path, "fit").stored("a problem")


@pytest.mark.parametrize("seed", range(24))
def test_wherever_bytes_change_what_can_be_read_is_right(tmp_path, seed):
    outcomes = [replace(WHOLE, cost=float(k)) for k in range(12)]
    stored(tmp_path, *outcomes)
    path = tmp_path / DATABASE
    damaged = bytearray(path.read_bytes())
    random = np.random.default_rng(seed)
    # Half of them at the beginning of a page, where SQLite has its own numbers.
    place = random.integers(len(damaged))
    place = place if seed % 2 else place // 4096 * 4096 + place % 30
    if seed % 8 == 0:
        del damaged[place:]
    else:
        damaged[place] ^= 1 << int(random.integers(8))
    path.write_bytes(damaged)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with locked(tmp_path):
            add_members(tmp_path, ["fit"])
            known = StoredRuns(tmp_path, "fit").stored("a problem")
            for number, (start, outcome) in known.items():
                assert_array_equal(start, START + number)
                require_same(outcome, outcomes[number])
    assert not mended(tmp_path)
    stored(tmp_path, *outcomes)
    assert len(StoredRuns(tmp_path, "fit").stored("a problem")) == 12


def test_the_database_of_another_program_is_left_alone(tmp_path):
    with closing(sqlite3.connect(tmp_path / DATABASE)) as database, database:
        database.execute("CREATE TABLE music (title TEXT)")
    whole = (tmp_path / DATABASE).read_bytes()
    with pytest.raises(ValueError, match="not a study"), locked(tmp_path):
        pass
    assert (tmp_path / DATABASE).read_bytes() == whole


def mended(folder):
    """What is said to be damaged."""
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always")
        with locked(folder):
            pass
    return [str(warning.message).removeprefix(f"{folder}: ") for warning in raised]


def change(folder, statement):
    with closing(sqlite3.connect(folder / DATABASE)) as database, database:
        database.execute(statement)


def test_members_keep_their_numbers(tmp_path):
    names = ["pitch, 5°", "a" * 80, "../.."]
    add_members(tmp_path, names)
    again = add_members(tmp_path, ["yaw", "pitch, 5°"])
    assert [member.name for member in again.values()] == [*names, "yaw"]


def test_names_are_printed_without_control_characters(tmp_path):
    add_members(tmp_path, ["a\x1b[0m"])
    assert [member.name for member in read_members(tmp_path)] == ["a\\x1b[0m"]


def test_a_folder_is_written_to_by_one_process_at_a_time(tmp_path, monkeypatch):
    monkeypatch.setattr("greybox.workflows.study.study_lock.PATIENCE", 0.01)
    with (
        locked(tmp_path),
        pytest.raises(BlockingIOError, match="another process is writing to"),
        locked(tmp_path),
    ):
        pass
    with locked(tmp_path):
        pass


def test_a_folder_that_cannot_be_made_is_refused_with_the_reason(tmp_path):
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(NotADirectoryError, match="Not a directory"),
        locked(tmp_path / "file" / "runs"),
    ):
        pass


def test_runs_of_a_fit_that_an_error_ends_are_written(tmp_path):
    def fit():
        with runs_beside(tmp_path / "fit.h5") as runs:
            runs.stored("a problem")
            runs.add(4, START, PLAIN)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fit()
    folder = folder_beside(tmp_path / "fit.h5")
    assert folder == tmp_path / "fit.h5.runs"
    assert [member.runs for member in read_members(folder)] == [1]


def test_a_folder_without_runs_is_removed(tmp_path):
    with runs_beside(tmp_path / "fit.h5"):
        assert (folder_beside(tmp_path / "fit.h5") / LOCK).exists()
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_does_not_end_a_fit_and_runs_are_written_once_there_is_space(tmp_path):
    from full_disk import limited_files

    with runs_beside(tmp_path / "fit.h5") as runs:
        runs.stored("a problem")
        with limited_files(4096):
            runs.add(0, START, replace(PLAIN, seconds=10 * UNWRITTEN))
        assert "cannot be written" in runs.trouble
        runs.write()
        assert runs.trouble == ""
        assert runs.count == 1
