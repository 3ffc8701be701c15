"""Files of runs that are merged keep all of them, whatever they hold."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from greybox.files.sealed_files import write_sealed
from greybox.solve.kept_runs import KeptRunsError
from greybox.solve.outcome import IMPROVED, Outcome
from greybox.study.run_files import UNWRITTEN, RunFiles, _Columns, _fill, count_runs

START = np.array([0.5, 0.25])
NODES = (np.arange(6.0).reshape(2, 3), np.ones((1, 1)))
PLAIN = Outcome(np.array([1.0, 2.0]), "Solve_Succeeded", 3, 0.5, True, stage=IMPROVED)
WHOLE = Outcome(
    np.array([3.0, 4.0]), "stagnated", 9, 1.5, False, 2.5, np.array([1.0, 2.0, 3.0]), NODES
)


def kept(folder, *batches):
    files = RunFiles(folder)
    files.known("a problem")
    for batch in batches:
        for number, outcome in batch:
            files.add(number, START + number, outcome)
        files.write()
    return files


def require_same(found, wanted):
    for name in ("status", "iterations", "seconds", "converged", "stage"):
        assert getattr(found, name) == getattr(wanted, name)
    assert_array_equal(found.estimate, wanted.estimate)
    assert_array_equal(found.cost, wanted.cost)
    assert (found.signature is None) == (wanted.signature is None)
    assert wanted.signature is None or np.array_equal(found.signature, wanted.signature)
    assert (found.nodes is None) == (wanted.nodes is None)
    for array, other in zip(found.nodes or (), wanted.nodes or (), strict=True):
        assert_array_equal(array, other)


@pytest.mark.parametrize(
    ("first", "second"), [(PLAIN, WHOLE), (WHOLE, PLAIN), (WHOLE, WHOLE), (PLAIN, PLAIN)]
)
def test_merged_files_hold_what_each_of_them_held(tmp_path, first, second):
    files = kept(tmp_path, [(7, first)], [(-1, second)])
    assert files.count == 2
    assert len([*tmp_path.iterdir()]) == 1
    known = RunFiles(tmp_path).known("a problem")
    assert sorted(known) == [-1, 7]
    assert len(known) == 2
    for number, wanted in ((7, first), (-1, second)):
        start, found = known[number]
        assert_array_equal(start, START + number)
        require_same(found, wanted)
    assert 0 not in known
    assert 8 not in known


def test_of_a_run_in_two_files_the_later_counts(tmp_path):
    three = [(number, PLAIN) for number in range(3)]
    kept(tmp_path, three, [(1, WHOLE)])
    assert len([*tmp_path.iterdir()]) == 2
    known = RunFiles(tmp_path).known("a problem")
    assert len(known) == 3
    require_same(known[1][1], WHOLE)
    require_same(known[2][1], PLAIN)


def test_what_took_long_or_is_old_is_written(tmp_path, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("greybox.study.run_files.time", SimpleNamespace(monotonic=lambda: now[0]))
    files = RunFiles(tmp_path)
    files.known("a problem")
    files.add(0, START, replace(PLAIN, seconds=0.6 * UNWRITTEN))
    now[0] += 0.9 * UNWRITTEN
    files.look()
    assert files.count == 0
    files.add(1, START, replace(PLAIN, seconds=0.5 * UNWRITTEN))  # together they took long
    assert files.count == 2
    files.add(2, START, replace(PLAIN, seconds=0.0))
    now[0] += 0.9 * UNWRITTEN
    files.look()
    assert files.count == 2
    now[0] += 0.2 * UNWRITTEN
    files.look()
    assert files.count == 3


def test_as_many_files_as_a_binary_number_has_digits_and_none_once_they_are_removed(tmp_path):
    files = kept(tmp_path, *([(number, PLAIN)] for number in range(7)))
    assert files.count == count_runs(tmp_path) == 7
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "runs-000004-4.h5",
        "runs-000006-2.h5",
        "runs-000007-1.h5",
    ]
    again = RunFiles(tmp_path)
    again.known("a problem")
    again.add(7, START, PLAIN)
    again.write()
    assert [path.name for path in tmp_path.iterdir()] == ["runs-000008-8.h5"]
    (tmp_path / ".runs-000009.part").touch()
    (tmp_path / "runs-12-1.h5").touch()  # not of ours
    again.remove()
    assert again.count == 0
    assert [path.name for path in tmp_path.iterdir()] == ["runs-12-1.h5"]


@pytest.mark.parametrize(
    ("columns", "attributes", "said"),
    [
        ({}, {"layout": 2}, "has layout 2 and this version reads up to 1: install a newer greybox"),
        ({}, {"fingerprint": "other"}, "was made for another problem, with other options"),
        ({}, {"statuses": "[3]"}, "is damaged"),
        ({}, {"statuses": '"Solved"'}, "is damaged"),
        ({"cost": np.zeros(3)}, {}, "is damaged"),
        ({"start": np.zeros(2)}, {}, "is damaged"),
        ({"estimate": np.zeros(2)}, {}, "is damaged"),
        ({"status": np.array([0, 2])}, {}, "is damaged"),
        ({"status": np.array([-1, 0])}, {}, "is damaged"),
        ({"stage": np.array([0, 3])}, {}, "is damaged"),
    ],
)
def test_a_file_that_does_not_hold_together_is_refused(tmp_path, columns, attributes, said):
    runs = _Columns.of([(0, START, PLAIN), (1, START, WHOLE)])
    changed = _Columns({**runs.columns, **columns}, runs.statuses, runs.shapes)

    def fill(file):
        _fill(file, changed, "a problem")
        file.attrs.update(attributes)

    write_sealed(tmp_path / "runs-000001-2.h5", "runs", fill)
    with pytest.raises(KeptRunsError, match=said):
        RunFiles(tmp_path).known("a problem")
