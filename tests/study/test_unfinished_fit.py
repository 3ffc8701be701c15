"""Runs beside the file of a fit: they stay where an error ends the fit, and nothing stays without runs."""

import os

import numpy as np
import pytest

from greybox.solve.outcome import IMPROVED, Outcome
from greybox.study.run_files import RunFiles, count_runs
from greybox.study.study_folder import LOCK, locked
from greybox.study.unfinished_fit import kept_beside, runs_beside

RUN = Outcome(np.array([1.0, 2.0]), "Solve_Succeeded", 3, 0.5, True, stage=IMPROVED)


def test_runs_of_a_fit_that_an_error_ends_are_written(tmp_path):
    folder = runs_beside(tmp_path / "fit.h5")
    assert folder == tmp_path / "fit.h5.runs"

    def fit():
        with kept_beside(tmp_path / "fit.h5") as kept:
            kept.known("a problem")
            kept.add(4, np.array([0.5, 0.25]), RUN)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fit()
    assert count_runs(folder) == 1
    assert 4 in RunFiles(folder).known("a problem")


def test_a_folder_without_runs_is_removed(tmp_path):
    with kept_beside(tmp_path / "fit.h5"):
        assert (runs_beside(tmp_path / "fit.h5") / LOCK).exists()
    assert [*tmp_path.iterdir()] == []


def test_a_disk_that_is_full_does_not_end_a_fit_and_is_told_until_there_is_space(
    tmp_path, monkeypatch
):
    with kept_beside(tmp_path / "fit.h5") as kept:
        assert kept.trouble == ""
        with monkeypatch.context() as full:
            full.setattr(RunFiles, "write", lambda files: os.read(-1, 1))
            kept.write()
        assert "Bad file descriptor" in kept.trouble
        kept.write()
        assert kept.trouble == ""


def test_a_folder_that_cannot_be_made_is_said_with_the_reason(tmp_path):
    (tmp_path / "file").write_text("")
    reason = r"runs cannot be written \(Not a directory\): choose another folder\.$"
    with pytest.raises(NotADirectoryError, match=reason), locked(tmp_path / "file" / "runs"):
        pass


def test_a_folder_is_written_to_by_one_at_a_time(tmp_path, monkeypatch):
    monkeypatch.setattr("greybox.study.study_folder.PATIENCE", 0.01)
    with (
        locked(tmp_path),
        pytest.raises(BlockingIOError, match="another process is at work in"),
        locked(tmp_path),
    ):
        pass
    with locked(tmp_path):
        pass
