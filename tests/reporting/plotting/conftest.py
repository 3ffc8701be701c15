"""Fits and data that several figures are drawn of."""

from pathlib import Path

import numpy as np
import pytest
from drawn_lines import QUICK, TRUTH

import greybox as gb
from greybox.models.rotor import Rotor
from greybox.models.tilt import Tilt

DATA = Path(__file__).parents[3] / "problems" / "data"


def table(file, prefix, **options):
    return gb.read_response(DATA / f"{file}.csv", prefix=prefix, **options)


@pytest.fixture(scope="session")
def pitch():
    data = table("table_3_1", "pitch_", input="u", output="theta", name="pitch")
    return gb.fit(gb.Problem(Tilt(), data), **QUICK)


@pytest.fixture(scope="session")
def rotors():
    parts = [
        gb.Problem(Rotor(), table("table_4_2", f"rotor{k}_", name=f"rotor {k}"))
        for k in (1, 2, 3, 4)
    ]
    return gb.fit(parts[0] + parts[1] + parts[2] + parts[3], **QUICK)


@pytest.fixture(scope="session")
def two_points():
    hover = gb.Problem(
        Tilt(), table("table_3_1", "pitch_", name="hover"), rename={"a1": "a1_0", "a3": "a3_0"}
    )
    return gb.fit(hover + gb.Problem(Tilt(), table("table_4_3", "pitch_", name="5°")), **QUICK)


@pytest.fixture(scope="session")
def failed(pitch):
    return gb.fit(gb.Problem(Tilt(), pitch.parts[0].data), **QUICK, solver_options={"max_iter": 2})


@pytest.fixture(scope="session")
def sweep():
    """A delayed tilt whose phase wraps, with coherence and variance, in no order of frequency."""
    omega = np.random.default_rng(0).permutation(np.geomspace(0.5, 200, 40))
    exact = gb.frequency_response(Tilt(), TRUTH, omega).response
    variance = (0.1 * np.abs(exact)) ** 2
    known = {"coherence": np.full(40, 0.9), "variance": variance, "name": "sweep"}
    return gb.FrequencyResponse(omega, exact, "u", "theta", **known)
