"""A cause of one's own, beside those that are included."""

import numpy as np
import pytest
from scipy.signal import lfilter

import greybox as gb

STEP = 0.05


class Lag(gb.StateSpace):
    """v' = b u - d v."""

    states, inputs, outputs = ("v",), ("u",), ("v",)
    d, b = gb.Parameter(2.0, bounds=(0.1, 20)), gb.Parameter(3.0, bounds=(0.1, 20))

    def derivative(self, x, u, p):
        return (p.b * u.u - p.d * x.v,)

    def output(self, x, u, p):
        return (x.v,)


RIPPLE = gb.Wording(
    "a ripple of {signal}, {size} times its sine", "u.{signal} + p.ripple * gb.sin(9 * u.{signal})"
)


def ripples(flight):
    """Yield a ripple of every input."""
    for u in flight.inputs:
        yield u.term(RIPPLE, np.sin(9 * u.values), scale=1.0)


@pytest.fixture(scope="module")
def fit():
    """A fit to a record whose input has a ripple of 0.1."""
    random = np.random.default_rng(1)
    u = np.repeat(random.uniform(-1, 1, 60), 10)
    decay = np.exp(-2 * STEP)
    v = lfilter([0, 1.5 * (1 - decay)], [1, -decay], u + 0.1 * np.sin(9 * u))
    record = gb.Record(
        STEP * np.arange(u.size),
        {"u": u, "v": v + 0.01 * random.normal(size=u.size)},
        hold={"u": np.inf},
    )
    return gb.fit(gb.Problem(Lag(), record), starts=1, progress=False, profiles=False)


def test_a_cause_of_a_user_is_tried_beside_the_included_ones(fit):
    misfit = gb.misfit(fit, causes=[*gb.CAUSES, ripples])
    cause = misfit.likely[0]
    assert cause.text.startswith("a ripple of u, 0.")
    assert cause.code == "u.u + p.ripple * gb.sin(9 * u.u)"
    assert cause.value == pytest.approx(0.1, abs=3 * cause.error)
    assert misfit.tried > fit.misfit.tried


def test_without_causes_nothing_is_decided(fit):
    assert gb.misfit(fit, causes=[]) is None


@pytest.mark.parametrize("causes", ["delays", [ripples, "delays"]])
def test_causes_are_functions(fit, causes):
    with pytest.raises(TypeError, match="functions of a record"):
        gb.misfit(fit, causes=causes)
