"""Numbers that no square can hold, as damaged files have: nothing that follows overflows, not even with a warning."""

import contextlib

import numpy as np
import pytest
from declared_models import LagLagDelay
from numpy.testing import assert_array_equal
from sampled_lag import SampledLag

import greybox as gb

TIME = 0.02 * np.arange(300)
NOISE = np.random.default_rng(0).normal(size=300)
SIGNALS = {
    "noise": NOISE,
    "huge": 1e200 * NOISE,
    "tiny": 1e-200 * NOISE,
    "spike": np.where(np.arange(300) == 150, 1e150, NOISE),
    "zero": np.zeros(300),
    "constant": np.full(300, 3.0),
    "infinite": np.where(np.arange(300) == 7, np.inf, NOISE),
    "missing": np.full(300, np.nan),
}


def test_values_beyond_the_range_are_missing_and_those_below_are_zero():
    y = np.array([1e74, -1e76, 1e300, 0.0, -1e-76, 3e38, np.nan, -np.inf])
    record = gb.Record(np.arange(8.0), {"y": y})
    assert_array_equal(record["y"], [1e74, np.nan, np.nan, 0.0, 0.0, 3e38, np.nan, np.nan])
    assert not record["y"].flags.writeable


@pytest.mark.parametrize("value", [1e80, 1e-80, 1e200j])
def test_a_response_beyond_the_range_is_refused(value):
    with pytest.raises(ValueError, match="at index 1: squares of such numbers"):
        gb.FrequencyResponse([1.0, 2.0, 3.0], [1.0, value, 1.0])
    assert gb.FrequencyResponse([1.0, 2.0], [0.0, 1.0]).response[0] == 0


@pytest.mark.parametrize(
    ("u", "y"), [pair for s in SIGNALS for pair in ((s, "noise"), ("noise", s), (s, s))][2:]
)
def test_no_warning_of_our_own_arithmetic_reaches_a_user(u, y):
    """A sentence of an error may; every warning is an error here."""
    record = gb.Record(TIME, {"u": SIGNALS[u], "y": SIGNALS[y]})
    for step in (
        lambda: str(gb.prepare(record, signals={"u": "u", "y": "y"}, rate=25)),
        lambda: str(gb.spectral.spectral_response(record, "u", "y")),
        lambda: str(gb.spectral.check(record, input="u", output="y")),
        lambda: str(gb.regression.equation_error(SampledLag(), record)),
    ):
        with contextlib.suppress(ValueError):
            step()


@pytest.mark.parametrize("points", [1, 2, 12])
def test_a_response_of_which_the_model_is_zero(points):
    """K = 0, as at a bound: logarithm and ratio of zeros."""
    omega = np.geomspace(0.5, 20, 12)[:points]
    data = gb.FrequencyResponse(omega, 2 / (1 + 0.3j * omega), variance=np.full(points, 1e-3))
    starts = [{"K": 0.0, "T1": 10.0, "T2": 10.0}]
    relative = gb.fit(gb.Problem(LagLagDelay(), data, gb.RelativeError()), starts=starts)
    assert "sum of relative errors" in relative.details
    assert "maximum likelihood" in gb.fit(gb.Problem(LagLagDelay(), data), starts=starts).details
