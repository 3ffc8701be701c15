"""`greybox bootstrap` says what failed."""

from types import SimpleNamespace

import numpy as np
import pytest
from command_line import refused, run

import greybox.cli.bootstrap_command as command


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

    def bootstrap(fit, resampling, replicates, **options):
        asked.update(options, fit=fit, resampling=resampling, replicates=replicates)
        return found

    monkeypatch.setattr(command, "stated_fit", lambda options: ("fit", "problem"))
    monkeypatch.setattr(command, "bootstrap", bootstrap)
    got, out, err = run(
        capsys, "bootstrap", "x.h5", "--replicates", "5", "--seed", "7", "--block", "3", "--level", "0.9"
    )
    assert (got, out) == (status, "said at 0.9\n")
    assert err == ("greybox: too few.\n" if status else "")
    assert asked == {
        "fit": "fit", "problem": "problem", "resampling": None, "replicates": 5, "seed": 7, "block": 3,
        "executor": None, "folder": None,
    }  # fmt: skip


@pytest.mark.parametrize("level", ["0", "1", "95"])
def test_a_level_lies_between_zero_and_one(capsys, level):
    assert "must lie between 0 and 1, e.g. 0.95" in refused(capsys, "bootstrap", "x.h5", "--level", level)
