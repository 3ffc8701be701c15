"""Files of runs that are merged keep all of them, whatever they hold."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from greybox.solve.outcome import IMPROVED, Outcome
from greybox.study.run_files import RunFiles

START = np.array([0.5, 0.25])
NODES = (np.arange(6.0).reshape(2, 3), np.ones((1, 1)))
PLAIN = Outcome(np.array([1.0, 2.0]), "Solve_Succeeded", 3, 0.5, True, stage=IMPROVED)
WHOLE = Outcome(np.array([3.0, 4.0]), "stagnated", 9, 1.5, False, 2.5, np.array([1.0, 2.0, 3.0]), NODES)


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


@pytest.mark.parametrize(("first", "second"), [(PLAIN, WHOLE), (WHOLE, PLAIN), (WHOLE, WHOLE), (PLAIN, PLAIN)])
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
