"""Bad tables and contradictory options: refused in a sentence with the cure, and nothing is written."""

import shutil

import numpy as np
import pytest
from command_line import run

TIME = np.arange(0, 60, 0.02)
SINE = np.sin(3 * TIME)
PAIR = ("--input", "u", "--output", "y", "--whole")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Tables of time, u and y, each with a defect."""
    folder = tmp_path_factory.mktemp("tables")
    columns = {
        "sine": (TIME, SINE, np.sin(3 * TIME - 1)),
        "still": (0 * TIME, SINE, SINE),
        "missing": (TIME, SINE, np.nan * SINE),
        "huge": (TIME, SINE, 1e200 * (2 + SINE)),
    }
    for name, values in columns.items():
        np.savetxt(
            folder / f"{name}.csv",
            np.transpose(values),
            delimiter=",",
            header="time [s],u,y",
            comments="",
        )
    counts = np.transpose((np.arange(TIME.size), SINE, SINE))
    header = "timestamp,u,y"
    np.savetxt(folder / "counted.csv", counts, delimiter=",", header=header, comments="")
    return folder


@pytest.fixture
def tables(written, tmp_path, monkeypatch):
    """Return the working folder, with the tables."""
    monkeypatch.chdir(tmp_path)
    return shutil.copytree(written, tmp_path, dirs_exist_ok=True)


@pytest.mark.parametrize(
    ("words", "fragments"),
    [
        (("identify", "sine.csv", *PAIR), ("less than an octave",)),
        (
            ("identify", "still.csv", *PAIR),
            ("'time [s]', which stands still", "--rate HZ"),
        ),
        (("identify", "missing.csv", *PAIR), ("y has 0 values in 3000 samples, too few",)),
        (("identify", "huge.csv", *PAIR), ("beyond 1e75", "check its sensor")),
        (("identify", "counted.csv", *PAIR), ("counts by one", "time=timestamp:ms")),
        (("identify", "sine.csv", *PAIR, "--period", "0"), ("--period 0", "leave it out")),
        (("identify", "sine.csv", *PAIR, "--instrument", "y"), ("--instrument y is the output",)),
        (("identify", "sine.csv", *PAIR, "--conditioned", "u"), ("--conditioned u", "same signal")),
        (("identify", "sine.csv", *PAIR, "--fields", "omega=W"), ("--announced MESSAGE",)),
        (("identify", "sine.csv", "--input", "w", *PAIR[2:]), ("'w'", "u and y")),
        (("identify", "sine.csv"), ("--input NAME=SIGNAL", "it has u and y")),
        (("identify", "."), ("is a folder",)),
        (("response", "sine.csv", *PAIR, "--input", "u", "y"), ("--period",)),
    ],
)
def test_it_is_refused_with_the_cure(capsys, tables, words, fragments):
    before = sorted(tables.iterdir())
    status, out, error = run(capsys, *words)
    assert status == (1 if fragments == ("less than an octave",) else 2)
    assert all(fragment in error for fragment in fragments), error
    assert "Traceback" not in out + error
    assert sorted(tables.iterdir()) == before


@pytest.mark.usefixtures("few_structures")
def test_a_parameter_that_no_structure_has_is_refused(capsys, tables):
    wide = np.random.default_rng(0).normal(size=TIME.size)
    table = np.transpose((TIME, wide, wide + 0.01 * SINE))
    np.savetxt("wide.csv", table, delimiter=",", header="time [s],u,y", comments="")
    status, _, error = run(capsys, "identify", "wide.csv", *PAIR, "--fix", "zz=1")
    assert status == 2
    assert "has no parameter 'zz'" in error
