"""Many structures on many flights, as a researcher works: killed, resumed, compared, published.

Three structures of drag are fitted to six flights on three clocks, from 8 starts each. Two of the
flights carried a payload, which has more drag. The study is run on the command line by two workers,
killed half way and resumed; from Python, some of its members run without interruption.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import drag_structures
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import greybox as gb

STRUCTURES = ("Linear", "Quadratic", "Cubic")
C_X, C_X_PAYLOAD, NOISE = 0.25, 0.40, 0.05  # 1/m, 1/m, m/s
FLIGHTS = range(1, 7)  # their numbers
PAYLOAD = (3, 6)
MEMBERS = len(STRUCTURES) * (len(FLIGHTS) + 1)  # each flight, and all of them
STARTS = 8

STUDY = f"""
model = {[f"drag_structures.py:{name}" for name in STRUCTURES]}
held = "held.csv"
starts = {STARTS}

[[member]]
data = "flight_*.csv"

[[member]]
joint = [{", ".join(f'"flight_{number}.csv"' for number in FLIGHTS)}]
"""


def write_flight(path, number):
    """Write a table of 12 s of a flight, on a uniform clock, an uneven one, or with lost rows."""
    rng = np.random.default_rng(number)
    count, C_x = 120, C_X_PAYLOAD if number in PAYLOAD else C_X
    time_s = 0.1 * np.arange(count)
    if number % 3 == 1:
        time_s = time_s + rng.uniform(-0.03, 0.03, count)
    theta = np.repeat(rng.uniform(-0.35, 0.35, count // 8), 8)  # rad, held

    v = np.full(count, 0.5)  # m/s
    for k in range(count - 1):
        gravity = 9.80665 * np.tan(theta[k])
        span = time_s[k], time_s[k + 1]
        motion = solve_ivp(lambda _, v, a=gravity: a - C_x * abs(v) * v, span, v[k : k + 1])
        v[k + 1] = motion.y[0, -1]
    v += NOISE * rng.standard_normal(count)

    rows = np.arange(count)
    if number % 3 == 2:
        rows = np.delete(rows, [*range(50, 56), 80, 81, 100])
    table = np.column_stack([time_s, theta, v])[rows]
    header = "time [s],theta [rad held],v [m/s sampled]"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A researcher's folder: tables, structures, and the study file."""
    place = tmp_path_factory.mktemp("drag")
    for number in FLIGHTS:
        write_flight(place / f"flight_{number}.csv", number)
    write_flight(place / "held.csv", 9)
    shutil.copy(drag_structures.__file__, place)
    (place / "study.toml").write_text(STUDY)
    return place


def greybox(folder, *words):
    """Begin the command in a group of processes of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "greybox", *words],
        cwd=folder,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finished(folder):
    """Return how many members are done, also while the study runs."""
    try:
        return len(gb.study.read_study(folder).done)
    except FileNotFoundError:  # not begun
        return 0


@pytest.fixture(scope="module")
def resumed(folder):
    """The study of the command line: killed once half of its members are done, and resumed."""
    words = "batch", "study.toml", "--out", "out", "--workers", "2"
    with greybox(folder, *words) as first:
        while finished(folder / "out") < MEMBERS // 2 and first.poll() is None:
            time.sleep(0.1)
        assert first.poll() is None, first.communicate()
        os.killpg(first.pid, signal.SIGKILL)
    assert first.returncode == -signal.SIGKILL
    assert MEMBERS // 2 <= finished(folder / "out") < MEMBERS

    with greybox(folder, *words, "--json") as second:
        shown, errors = second.communicate()
    assert second.returncode == 0, errors
    assert len(json.loads(shown)["members"]) == MEMBERS
    return gb.study.read_study(folder / "out", models=[drag_structures])


@pytest.fixture(scope="module")
def uninterrupted(folder):
    """Members of the same study from Python: a flight on each clock, and all flights together."""
    structures = [getattr(drag_structures, name)() for name in STRUCTURES]
    flights = sorted(folder.glob("flight_*.csv"))
    common = {"held": folder / "held.csv", "starts": STARTS}
    members = gb.study.grid(structures, flights[:3], **common)
    members += gb.study.grid(structures[:2], joint=flights, **common)
    return gb.batch(members, folder / "python", progress=False)


def test_a_killed_study_ends_with_the_answers_of_an_uninterrupted_one(resumed, uninterrupted):
    assert len(resumed.members) == MEMBERS
    for twin in uninterrupted.members:
        member = resumed[twin.name]
        assert len(member.fit.runs) == STARTS
        assert (member.fit.cost, member.fit.estimate) == (twin.fit.cost, twin.fit.estimate)
        assert member.fit.standard_error == twin.fit.standard_error


def test_the_true_structure_is_supported_by_evidence_and_by_the_held_out_flight(resumed):
    comparison = gb.compare(resumed)
    assert comparison.labels == STRUCTURES
    assert comparison.supported == "Quadratic"

    held_out = "error of held-out predictions, % of the signal"
    for number in FLIGHTS:
        errors = {
            name: comparison.value(f"flight_{number}", name, data="study", output=held_out)
            for name in STRUCTURES
        }
        # The held-out flight had no payload.
        if number in PAYLOAD:
            assert errors["Quadratic"] > 10
        else:
            assert errors["Quadratic"] < min(5, errors["Linear"] / 2, errors["Cubic"] / 2)


def test_the_flights_that_disagree_are_named_with_their_parameter(resumed):
    joint = resumed["flight_1..flight_6: Quadratic"].fit
    assert not joint.is_explained
    cause = joint.misfit.likely[0].text
    assert "C_x" in cause
    assert any(f"'flight_{number}'" in cause for number in PAYLOAD), cause

    fits = {n: resumed[f"flight_{n}: Quadratic"].fit for n in FLIGHTS}
    for number in FLIGHTS[1:]:
        rows = gb.validation.differences(fits[1], fits[number])
        # Holm's p is below 0.001 by chance in one of a thousand flights.
        assert (rows["C_x"].p_of_all < 1e-3) == (number in PAYLOAD), rows
        assert rows["K"].p_of_all > 1e-3, rows
    for number, fit in fits.items():
        truth = C_X_PAYLOAD if number in PAYLOAD else C_X
        assert abs(fit.estimate["C_x"] - truth) < 4 * fit.standard_error["C_x"]


def test_the_study_becomes_a_table_for_a_paper_and_figures(folder, resumed, tmp_path):
    table, rows = tmp_path / "table.tex", tmp_path / "table.csv"
    words = "compare", "out", "--model", "drag_structures.py", "--latex", table, "--csv", rows
    with greybox(folder, *map(str, words), "--json") as process:
        shown, errors = process.communicate()
    assert process.returncode == 0, errors
    assert len(json.loads(shown)["members"]) == MEMBERS
    assert table.read_text().strip() == resumed.to_latex().strip()
    assert table.read_text().count("\\begin{tabular}") == 3
    assert len(rows.read_text().splitlines()) == 1 + 2 * MEMBERS  # two parameters each

    figures = {
        "C_x.png": gb.plotting.estimates(resumed.select(model="Quadratic"), "C_x"),
        "structures.png": gb.plotting.structures(gb.compare(resumed)),
    }
    for name, axes in figures.items():
        axes.figure.savefig(tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
