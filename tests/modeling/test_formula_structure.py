"""Switches in place of their means over a sampling interval, against quadrature over a period."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.modeling.formula_structure import (
    ELEMENTARY,
    has_switches,
    interval_means,
    with_finite_slopes,
)

z = ca.SX.sym("z", 2)
p = ca.SX.sym("p")
POINTS = 257
PHASE = 2 * np.pi * np.arange(POINTS) / POINTS


def period_mean(formula, threshold, wave):
    """The mean over a period of a formula of (1.6 cos φ, sin φ) times wave(φ), from the means of intervals."""
    slopes, sizes = ca.SX.sym("slopes", 2), ca.SX.sym("sizes", 2)
    means = interval_means(formula, z, slopes, sizes, 2 * np.pi / POINTS)
    function = ca.Function("mean", [z, slopes, sizes, p], [means])
    signals = np.array([1.6 * np.cos(PHASE), np.sin(PHASE)])
    speeds = np.array([-1.6 * np.sin(PHASE), np.cos(PHASE)])
    values = function(signals, speeds, np.zeros_like(signals), np.full((1, POINTS), threshold))
    return np.mean(np.asarray(values).ravel() * wave(PHASE))


@pytest.mark.parametrize(
    "formula",
    [
        gb.sign(z[0] - p),
        gb.where(z[0] > p, z[0], 0.0),
        gb.where(z[0] > p, gb.where(z[1] > 0, z[0], -2.0), 1.0),
        ca.if_else(ca.logic_and(z[0] <= p, z[1] > 0), z[1], z[0] ** 2),
        ca.if_else(ca.logic_or(z[0] <= p, z[1] > 0), z[1], z[0] ** 2),
        gb.maximum(gb.minimum(z[0], p), -p),
        gb.maximum(z[0], z[1]) - 2 * gb.minimum(z[0], z[1] ** 2),
        z[0] ** 2 * gb.sign(z[1]),
        abs(z[0] - p),
    ],
    ids=str,
)
@pytest.mark.parametrize("wave", [np.cos, lambda x: np.sin(3 * x)], ids=["cos", "sin 3"])
def test_interval_means_add_up_to_the_integral_over_a_period(formula, wave):
    """Against the midpoint rule on 20 000 samples."""
    phase = 2 * np.pi * (np.arange(20_000) + 0.5) / 20_000
    plain = ca.Function("plain", [z, p], [formula])
    values = plain(np.array([1.6 * np.cos(phase), np.sin(phase)]), np.full((1, phase.size), 0.3))
    exact = np.mean(np.asarray(values).ravel() * wave(phase))
    assert period_mean(formula, 0.3, wave) == pytest.approx(exact, abs=3e-4)


def test_the_instant_of_a_switch_has_a_derivative():
    """The mean of sign(1.6 cos φ - c) is 1 - 2 arccos(-c/1.6)/π, turned round."""
    c = np.array([0.3, 0.301])
    means = [period_mean(gb.sign(z[0] - p), threshold, np.ones_like) for threshold in c]
    assert_allclose(means, 2 * np.arccos(c / 1.6) / np.pi - 1, atol=1e-4)
    slope = -2 / np.pi / np.sqrt(1.6**2 - 0.3**2)
    assert (means[1] - means[0]) / 0.001 == pytest.approx(slope, rel=0.02)


def test_a_switch_that_rests_turns_as_slowly_as_its_signals_usually_move():
    slopes, sizes = ca.SX.sym("slopes", 2), ca.SX.sym("sizes", 2)
    means = interval_means(gb.sign(z[0]), z, slopes, sizes, 0.5)
    function = ca.Function("mean", [z, slopes, sizes], [means])
    # A twentieth of the size 4 for half of 0.5: a reach of 0.05.
    assert float(function([0.02, 0], [0, 0], [4, 0])) == pytest.approx(0.4)
    assert float(function([0.02, 0], [1, 0], [0, 0])) == pytest.approx(0.02 / 0.25)


def test_only_formulas_with_switches_take_more_samples():
    assert has_switches(gb.maximum(z[0], p))
    assert has_switches(gb.where(z[0] > p, 1.0, 2.0))
    assert not has_switches(abs(z[0]) * z[0])


@pytest.mark.parametrize("formula", [ca.floor(z[0]), ca.fmod(z[0], 2.0), z[1] + ca.ceil(z[0])])
def test_a_rounding_is_refused(formula):
    with pytest.raises(ValueError, match=r"write it with gb\.sign or gb\.where"):
        interval_means(formula, z, z, z, 0.1)


def every_operation():
    """All operations on one or two scalars that CasADi knows, each of them on z and p."""
    for name in sorted(name for name in dir(ca) if name.startswith("OP_")):
        try:
            formula = ca.SX.binary(getattr(ca, name), z[0] * p + 0.3, ca.cos(z[1]))
        except (RuntimeError, NotImplementedError):
            continue
        if ca.symvar(formula):  # CasADi makes a zero of operations on matrices, and of calls
            yield pytest.param(formula, id=name)


@pytest.mark.parametrize("formula", [*every_operation()])
def test_every_operation_of_casadi_is_the_same_after_a_reading(formula):
    """Beside a guarded root, for which the formula is taken apart, and within one."""
    guarded = gb.sqrt(gb.maximum(z[0], 0))
    formulas = ca.vertcat(formula, formula * guarded, gb.sqrt(gb.maximum(formula**2 + 1, 0)))
    symbols = ca.vertcat(z, p)
    before, after = (
        ca.Function("f", [symbols], [f, ca.jacobian(f, symbols)])
        for f in (formulas, with_finite_slopes(formulas))
    )
    # No guard shuts here: only then do slopes differ.
    for point in np.random.default_rng(0).uniform(0.1, 1.5, (20, 3)):
        for plain, read in zip(before(point), after(point), strict=True):
            finite = np.isfinite(plain.full())
            assert_allclose(read.full()[finite], plain.full()[finite], rtol=1e-12)


def test_elementary_operations_are_all_that_casadi_applies_to_scalars():
    """Another one, of a later version, is left alone; here it shows."""
    names = {parameter.id for parameter in every_operation()}
    left_alone = {name for name in names if getattr(ca, name) not in ELEMENTARY}
    assert len(names) > 40
    assert left_alone <= {"OP_LIFT", "OP_PRINTME"}
