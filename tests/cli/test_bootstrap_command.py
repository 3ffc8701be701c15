"""`greybox bootstrap` says what failed."""

from types import SimpleNamespace

import numpy as np
import pytest
from command_line import refused, run

import greybox.cli.bootstrap_command as command
from greybox.engine.solve.lost_workers import ExecutorLostError


@pytest.mark.parametrize(("failed", "status"), [(3, 0), (4, 1)])
def test_fewer_than_two_replicates_are_no_answer(capsys, monkeypatch, failed, status):
    found = SimpleNamespace(
        failed=failed,
        values=np.zeros((5, 2)),
        warnings=("too few.",),
        summary=lambda level: {"level": level},
        text=lambda level: f"said at {level}",
    )
    asked = {}

    def bootstrap(fit, replicates, **options):
        asked.update(options, fit=fit, replicates=replicates)
        return found

    monkeypatch.setattr(command, "stated_fit", lambda options: ("fit", "problem"))
    monkeypatch.setattr(command, "bootstrap", bootstrap)
    got, out, err = run(
        capsys,
        "bootstrap",
        "x.h5",
        "--replicates",
        "5",
        "--seed",
        "7",
        "--level",
        "0.9",
    )
    assert (got, out) == (status, "said at 0.9\n")
    assert err == ("greybox: too few.\n" if status else "")
    assert asked == {
        "fit": "fit", "problem": "problem", "replicates": 5, "seed": 7,
        "executor": None, "folder": None,
    }  # fmt: skip


@pytest.mark.parametrize("level", ["0", "1", "95"])
def test_a_level_lies_between_zero_and_one(capsys, level):
    assert "is not a probability between 0 and 1" in refused(
        capsys, "bootstrap", "x.h5", "--level", level
    )


@pytest.mark.parametrize(
    ("folder", "more"), [("replicates", "; the same command continues in replicates"), (None, "")]
)
def test_what_was_interrupted_goes_on_where_it_was_kept(capsys, monkeypatch, folder, more):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "stated_fit", lambda options: ("fit", "problem"))
    monkeypatch.setattr(command, "bootstrap", interrupted)
    out = [] if folder is None else ["--out", folder]
    assert run(capsys, "bootstrap", "x.h5", *out) == (
        130,
        "",
        f"greybox: interrupted{more}.\n",
    )


def test_replicates_are_kept_in_a_folder_and_a_lost_executor_is_told(capsys, monkeypatch, tmp_path):
    def lost(*arguments, **options):
        raise ExecutorLostError("the workers are gone.")

    monkeypatch.setattr(command, "stated_fit", lambda options: ("fit", "problem"))
    monkeypatch.setattr(command, "bootstrap", lost)
    assert run(capsys, "bootstrap", "x.h5", "--out", tmp_path) == (
        1,
        "",
        "greybox: the workers are gone; the same command continues with the stored runs.\n",
    )
