"""Parameter vectors of one response, and the constraint that chooses one of them."""

import re

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=6)


def same_response(fit):
    return [warning for warning in fit.warnings if "same response" in warning]


def test_lags_that_swap_are_shown_and_a_constraint_chooses_one():
    fit = gb.fit(gb.Problem(LagLagDelay(), DATA), progress=False)
    (text,) = same_response(fit)
    high, low = ("T1", "T2") if fit.estimate["T1"] > fit.estimate["T2"] else ("T2", "T1")
    other = {name: float(re.search(rf"{name} = ([\d.]*\d)", text)[1]) for name in ("T1", "T2")}
    assert other[low] == pytest.approx(fit.estimate[high], rel=1e-3)
    assert other[high] == pytest.approx(fit.estimate[low], rel=1e-3)
    ordered = gb.fit(
        gb.Problem(LagLagDelay(), DATA, constraints=[lambda p: p[high] - p[low]]),
        starts=4,
        progress=False,
    )
    assert not same_response(ordered)
    assert ordered.estimate[high] == pytest.approx(fit.estimate[high], rel=1e-3)


@pytest.mark.parametrize(
    ("starts", "seed", "ascend"),
    [(12, 3, True), (12, 4, True), ([{"T1": 2.0}], None, False), ([{"T2": 2.0}], None, True)],
)
def test_lags_that_swap_have_the_order_of_the_first_start_else_ascend(starts, seed, ascend):
    fit = gb.fit(gb.Problem(LagLagDelay(), DATA), starts, seed=seed, progress=False)
    lags = [fit.estimate["T1"], fit.estimate["T2"]]
    assert sorted(lags) == pytest.approx([0.1, 1.0], rel=0.05)
    assert lags == sorted(lags, reverse=not ascend)


class Integrator(gb.TransferFunction):
    """An integrator with two lags, a pole and a time constant: other values have its response."""

    input, output = "u", "y"
    K = gb.Parameter(1.0, bounds=(0.01, 50))
    a = gb.Parameter(1.0, bounds=(0, 20))
    T = gb.Parameter(0.05, bounds=(0, 1))

    def response(self, s, p):
        return p.K / (s * (s + p.a) * (p.T * s + 1))


class Square(gb.TransferFunction):
    """A gain that is the same for two values."""

    input, output = "u", "y"
    a = gb.Parameter(1.0, bounds=(-5, 5))
    T = gb.Parameter(0.3, bounds=(0.01, 5))

    def response(self, s, p):
        return (p.a - 0.5) ** 2 / (p.T * s + 1)


@pytest.mark.parametrize(("first", "second"), [(1.5, -0.5), (-0.5, 1.5)])
def test_the_value_that_is_farthest_from_the_estimate_is_named(first, second):
    data = measured(Square(), np.geomspace(0.3, 20, 10), {"a": 1.5, "T": 0.3}, noise=0.02, seed=1)
    starts = [{"a": 0.9 * first}, {"a": 0.9 * second}]
    fit = gb.fit(gb.Problem(Square(), data), starts, progress=False)
    (text,) = same_response(fit)
    assert fit.estimate["a"] == pytest.approx(first, rel=0.05)
    assert float(re.search(r"a = (-?[\d.]*\d)", text)[1]) == pytest.approx(second, rel=0.05)


def test_values_that_one_start_in_a_hundred_reaches_are_named():
    truth = {"K": 4.0, "a": 1.2, "T": 0.1}
    data = measured(Integrator(), np.geomspace(0.3, 20, 10), truth, noise=0.05, seed=1)
    fit = gb.fit(gb.Problem(Integrator(), data), progress=False)
    (text,) = same_response(fit)
    other = {name: float(re.search(rf"{name} = ([\d.]*\d)", text)[1]) for name in truth}
    assert fit.estimate["a"] * other["T"] == pytest.approx(1, rel=1e-3)
    assert fit.estimate["T"] * other["a"] == pytest.approx(1, rel=1e-3)


def test_a_minimum_that_eight_agreeing_starts_miss_is_found():
    truth = {"K": 4.0, "a": 1.2, "T": 0.01}
    data = measured(Integrator(), np.geomspace(0.3, 10, 10), truth, noise=0.05, seed=1)
    fit = gb.fit(gb.Problem(Integrator(), data), progress=False)
    assert fit.estimate["a"] == pytest.approx(1.2, rel=0.1)  # else 17, with K at its bound


class Ladder(gb.StateSpace):
    """Three stages of a resistor and a capacitor of one farad, measured at the end."""

    states, inputs, outputs = ("a", "b", "c"), ("u",), ("c",)
    R1 = gb.Parameter(1.0, bounds=(0.05, 20))
    R2 = gb.Parameter(1.0, bounds=(0.05, 20))
    R3 = gb.Parameter(1.0, bounds=(0.05, 20))

    def derivative(self, x, u, p):
        flows = (u.u - x.a) / p.R1, (x.a - x.b) / p.R2, (x.b - x.c) / p.R3
        return (flows[0] - flows[1], flows[1] - flows[2], flows[2])

    def output(self, x, u, p):
        return (x.c,)


def test_values_of_a_record_with_the_same_response_are_named():
    random = np.random.default_rng(3)
    u = np.repeat(random.choice([-1.0, 1.0], 15), 20)
    record, rest = gb.Record(0.3 * np.arange(300), {"u": u}), dict.fromkeys("abc", 0.0)
    truth = {"R1": 1.4, "R2": 0.82, "R3": 0.98}
    c = gb.simulate(Ladder(), truth, record, initial=rest, inputs="held")["c"]
    noisy = record.with_signals(c=c + 0.01 * random.normal(size=300))
    rule = gb.OutputError(inputs="held", initial=rest)
    fit = gb.fit(gb.Problem(Ladder(), noisy, rule), progress=False)
    (text,) = same_response(fit)
    other = {name: float(re.search(rf"{name} = ([\d.]*\d)", text)[1]) for name in truth}
    assert other["R1"] < 0.5 * fit.estimate["R1"]
    omega = np.geomspace(0.1, 5, 20)
    pair = [gb.frequency_response(Ladder(), p, omega).response for p in (fit.estimate, other)]
    assert np.abs(pair[0] - pair[1]).max() < 1e-3


class Bounded(LagLagDelay):
    """The same with bounds that the shorter lag cannot have."""

    T1 = gb.Parameter(0.5, bounds=(0.5, 5), unit="s", about="first lag")


class Leading(LagLagDelay):
    """A lead over a lag: exchanged, they are another response."""

    def response(self, s, p):
        return p.K * (p.T1 * s + 1) / (p.T2 * s + 1)


def test_parameters_that_do_not_exchange_keep_their_values():
    bounded = gb.fit(gb.Problem(Bounded(), DATA), [{}], progress=False)
    assert bounded.estimate["T1"] > bounded.estimate["T2"]
    truth = {"K": 2.0, "T1": 1.0, "T2": 0.1}
    data = measured(Leading(), TWO_LAGS_OMEGA, truth, noise=0.01, seed=1)
    lead = gb.fit(gb.Problem(Leading(), data, fixed={"tau": 0.0}), [{}], progress=False)
    assert [lead.estimate[name] for name in truth] == pytest.approx([*truth.values()], rel=0.05)
