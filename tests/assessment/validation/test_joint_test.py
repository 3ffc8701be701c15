"""The joint test of parameters, against the F test of least squares and over random draws."""

import numpy as np
import pytest
from scipy.stats import f, kstest

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")


class Cubic(gb.StateSpace):
    """A polynomial of the input."""

    inputs, outputs = ("x",), ("y",)
    a = gb.Parameter(0.0, bounds=(-10, 10))
    b = gb.Parameter(0.0, bounds=(-10, 10))
    c = gb.Parameter(0.0, bounds=(-10, 10))
    d = gb.Parameter(0.0, bounds=(-10, 10))

    def output(self, x, u, p):
        return p.a + p.b * u.x + p.c * u.x**2 + p.d * u.x**3


X = np.linspace(-1, 1, 40)


def line(seed, c=0.0):
    """Rows of 1 + 2 x + c x², with errors of 0.1."""
    errors = 0.1 * np.random.default_rng(seed).normal(size=X.size)
    return gb.Record(None, {"x": X, "y": 1 + 2 * X + c * X**2 + errors})


def fitted(record, **options):
    return gb.fit(gb.Problem(Cubic(), record, **options), starts=[{}], progress=False)


@pytest.mark.parametrize("c", [0.0, 0.6])
def test_without_priors_it_is_the_f_test_of_least_squares(c):
    record = line(3, c)
    columns = np.vander(X, 4, increasing=True)

    def squares(columns):
        best = np.linalg.lstsq(columns, record["y"], rcond=None)[0]
        return np.sum((record["y"] - columns @ best) ** 2)

    full = squares(columns)
    statistic = (squares(columns[:, :2]) - full) / 2 / (full / (X.size - 4))
    found = gb.validation.joint_test(fitted(record), ["c", "d"])
    assert found.statistic == pytest.approx(statistic, rel=1e-6)
    assert found.dof == pytest.approx((2, X.size - 4))
    assert found.p_value == pytest.approx(f.sf(statistic, 2, X.size - 4), rel=1e-5)
    assert found.effective == pytest.approx(2)
    assert ("not shown" in str(found)) == (c == 0)


def test_other_values_than_zero_are_tested():
    found = gb.validation.joint_test(fitted(line(3)), ["a", "b"], {"a": 1.0, "b": 2.0})
    assert found.p_value > 0.01
    assert gb.validation.joint_test(fitted(line(3)), ["a", "b"]).p_value < 1e-9


def test_a_prior_costs_no_false_alarms():
    """It pulls the estimate to its mean, and the standard errors become smaller: not the test."""
    prior = {"c": (0.0, 0.1), "d": (0.0, 0.1)}
    tests = [
        gb.validation.joint_test(fitted(line(seed), prior=prior), ["c", "d"]) for seed in range(30)
    ]
    # The data know c better than d: together they are worth less than two numbers.
    assert all(1.0 < test.effective < 1.9 for test in tests)
    assert kstest([test.p_value for test in tests], "uniform").pvalue > 0.01

    needed = gb.validation.joint_test(fitted(line(3, 0.3), prior=prior), ["c", "d"])
    assert needed.p_value < 0.001


def test_a_prior_far_from_the_truth_is_not_taken_for_the_data():
    wrong = {"c": (1.0, 0.2), "d": (0.0, 0.2)}
    found = gb.validation.joint_test(fitted(line(3), prior=wrong), ["c", "d"])
    assert found.p_value > 0.01


def test_what_cannot_be_tested_is_refused():
    fit = fitted(line(3), fixed={"d": 0.0})
    with pytest.raises(ValueError, match="free parameter 'd'"):
        gb.validation.joint_test(fit, ["c", "d"])
    with pytest.raises(ValueError, match="names is empty"):
        gb.validation.joint_test(fit, [])
    tight = fitted(line(3), prior={"c": (0.0, 1e-3)})
    with pytest.raises(ValueError, match="the priors say more"):
        gb.validation.joint_test(tight, ["c"])
