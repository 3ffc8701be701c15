"""Formulas taken apart: linear terms, switches and jumps against their meaning, interval means against quadrature."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.modeling.formula_structure import has_jumps, has_switches, interval_mean, separated

z = ca.SX.sym("z", 3)
p = ca.SX.sym("p")

FORMULAS = {
    "linear": p * z[0] - z[1] / 2 + gb.where(p > 0, z[2], -z[2]),
    "relay beside a gain": 3 * z[0] + p * gb.sign(z[1]),
    "linear inside a product": (z[0] + z[1]) * (z[2] - p),
    "comparison": gb.where(z[0] > p, z[1], 2.0),
    "rounding": z[0] + ca.floor(z[1]),
    "drag": 2 * z[0] - abs(z[1]) * z[1],
}


@pytest.mark.parametrize("name", FORMULAS)
def test_the_parts_add_up_and_the_coefficients_are_free_of_the_signals(name):
    linear, rest = separated(FORMULAS[name], z)
    assert not ca.depends_on(linear, z)
    both = ca.Function("both", [z, p], [FORMULAS[name], linear @ z + rest])
    for point in np.random.default_rng(0).normal(size=(5, 4)):
        whole, sum_of_parts = both(point[:3], point[3])
        assert float(whole) == pytest.approx(float(sum_of_parts))


@pytest.mark.parametrize(
    ("name", "linear_in", "rest_of"),
    [
        ("linear", [0, 1, 2], []),
        ("relay beside a gain", [0], [1]),
        ("linear inside a product", [], [0, 1, 2]),
        ("comparison", [], [0, 1]),
        ("rounding", [0], [1]),
        ("drag", [0], [1]),
    ],
)
def test_a_term_is_linear_or_left_over_even_where_its_derivative_is_zero(name, linear_in, rest_of):
    linear, rest = separated(FORMULAS[name], z)
    assert [j for j in range(3) if not linear[0, j].is_zero()] == linear_in
    assert [j for j in range(3) if ca.depends_on(rest, z[j])] == rest_of


@pytest.mark.parametrize(
    ("formula", "switches", "jumps"),
    [
        (gb.sign(z[0]), True, True),
        (gb.where(z[0] > p, 1.0, 2.0), True, True),
        (ca.floor(z[0]), True, True),
        (ca.ceil(z[0]), True, True),
        (ca.fmod(z[0], 2.0), True, True),
        (ca.remainder(z[0], 2.0), True, True),
        (ca.copysign(z[0], z[1]), True, True),
        (1e-3 * gb.sign(z[0] ** 3 + z[0] - 20), True, True),
        (1e9 + 1e-3 * gb.sign(z[0]), False, False),  # a part in 1e12 is rounding
        (-1e9 + 1e-3 * gb.sign(z[0]), False, False),
        (gb.sign(z[0]) * (abs(z[0]) + 1), True, True),
        (gb.where(z[0] > 0, gb.sign(z[1]), 0.0), True, True),
        (abs(z[0]), True, False),
        (gb.maximum(z[0], p), True, False),
        (gb.where(z[0] > p, z[0], p), True, False),
        (abs(z[0]) * z[0], False, False),
        (gb.sign(z[0]) * z[0] ** 3, False, False),
        (gb.sign(p) * z[0] ** 3, False, False),
    ],
    ids=str,
)
def test_switches_are_jumps_and_kinks_that_the_signals_decide(formula, switches, jumps):
    assert has_switches(formula, z) is switches
    assert has_jumps(formula, z, z) is jumps


def test_a_jump_that_another_signal_decides_does_not_count():
    formula = gb.sign(z[0]) + z[1]
    assert has_jumps(formula, z, z[0])
    assert not has_jumps(formula, z, z[1])


def integral(formula, wave, points, threshold=0.3):
    """The mean over a period of a formula of (1.6 cos φ, sin φ, 0) times wave(φ), from the means of intervals."""
    slopes, sizes = ca.SX.sym("slopes", 3), ca.SX.sym("sizes", 3)
    function = ca.Function(
        "mean",
        [z, slopes, sizes, p],
        list(interval_mean(formula, z, slopes, sizes, 2 * np.pi / points)),
    )
    total = 0.0
    for phase in 2 * np.pi * (np.arange(points) + 0.125) / points:
        signals, speeds = (
            [1.6 * np.cos(phase), np.sin(phase), 0.0],
            [-1.6 * np.sin(phase), np.cos(phase), 0.0],
        )
        mean, moment = function(signals, speeds, np.zeros(3), threshold)
        slope = (wave(phase + 1e-5) - wave(phase - 1e-5)) / 2e-5
        total += (float(mean) * wave(phase) + float(moment) * slope) / points
    return total


def mean_of_samples(formula, wave):
    phase = 2 * np.pi * (np.arange(200_000) + 0.5) / 200_000
    plain = ca.Function("plain", [z, p], [formula])
    signals = np.array([1.6 * np.cos(phase), np.sin(phase), 0 * phase])
    return np.mean(np.asarray(plain(signals, np.full((1, phase.size), 0.3))).ravel() * wave(phase))


@pytest.mark.parametrize(
    "formula",
    [
        ca.floor(z[0] + z[1]),
        ca.ceil(z[0] - p),
        ca.fmod(z[0] + 0.3 * z[1], 0.7),
        ca.remainder(z[0], 0.7) * z[1],
        ca.copysign(z[0] - p, z[1]),
        ca.if_else(z[0] <= p, z[1], z[0] ** 2),
        gb.maximum(z[0], z[1]) - 2 * gb.minimum(z[0], z[1] ** 2),
        gb.sign(z[0] - 0.2 * gb.sign(z[1])),
    ],
    ids=str,
)
def test_every_operation_with_a_switch_has_its_means(formula):
    assert integral(formula, np.cos, 65) == pytest.approx(
        mean_of_samples(formula, np.cos), abs=3e-4
    )


@pytest.mark.parametrize(
    "formula",
    [
        gb.sign(z[0] - p),
        gb.where(z[0] > p, z[0], 0.0),
        gb.maximum(gb.minimum(z[0], p), -p),
        gb.where(z[0] > p, gb.sign(z[1]), 2.0),
        z[0] ** 2 * gb.sign(z[1]),
    ],
    ids=str,
)
@pytest.mark.parametrize("wave", [np.cos, lambda x: np.sin(3 * x)], ids=["cos", "sin 3"])
def test_interval_means_add_up_to_the_integral_over_a_period(formula, wave):
    """Against the midpoint rule on 200 000 samples; finer they are nearer, within its own error."""
    wanted = mean_of_samples(formula, wave)
    coarse, fine = (abs(integral(formula, wave, points) - wanted) for points in (33, 131))
    assert coarse < 5e-4
    assert fine < 2e-5


def test_the_instant_of_a_switch_has_a_derivative():
    """The mean of sign(1.6 cos φ - c) is 1 - 2 arccos(-c/1.6)/π, turned round."""
    c = np.array([0.3, 0.301])
    means = [integral(gb.sign(z[0] - p), lambda x: 1.0, 65, threshold) for threshold in c]
    assert_allclose(means, 2 * np.arccos(c / 1.6) / np.pi - 1, atol=1e-4)
    assert (means[1] - means[0]) / 0.001 == pytest.approx(
        -2 / np.pi / np.sqrt(1.6**2 - 0.3**2), rel=0.02
    )


def test_coefficients_are_those_of_an_affine_formula_whatever_it_is_written_with():
    """Sums, differences, signs, doublings, products and quotients by constants, and terms that cancel."""
    formula = (
        -(z[0] + z[0])
        + (z[1] * p) / (1 + p)
        - (z[2] - z[2] + 3) * (z[0] - 2 * p)
        + ca.if_else(p > 0, 7 * z[2], 0)
    )
    formula = formula - (p - z[1]) / -4
    linear, rest = separated(ca.vertcat(formula, p * p - 5), z)
    value = ca.Function("both", [p], [linear, rest])
    for at, gate in ((2.0, 1.0), (-3.0, 0.0)):
        found, left = (np.asarray(ca.DM(v)) for v in value(at))
        assert_allclose(found, [[-5, at / (1 + at) - 0.25, 7 * gate], [0, 0, 0]])
        assert_allclose(left.ravel(), [6 * at + at / 4, at**2 - 5])


@pytest.mark.parametrize(
    ("formula", "linear_in"),
    [
        ((z[0] - z[0] + p) * z[1], [1]),
        (p / (1 + z[0]) + z[2], [2]),
        ((z[0] + 2) ** 2 + z[1], [1]),
        (ca.if_else(z[0] > p, 0, 1) * 2 - z[1], [1]),
        ((z[0] * z[1] + z[2]) * 3 - z[1], [1, 2]),
        ((ca.sin(z[0]) + p) * z[1], []),
        (z[1] / (p + z[0] ** 2) + z[2] * (p - p * z[0]), []),
    ],
    ids=str,
)
def test_what_is_multiplied_by_a_signal_is_not_linear(formula, linear_in):
    linear, rest = separated(ca.SX(formula), z)
    assert [j for j in range(3) if not linear[0, j].is_zero()] == linear_in
    both = ca.Function("both", [z, p], [formula, linear @ z + rest])
    whole, parts = both([0.3, -1.7, 2.2], 0.6)
    assert float(whole) == pytest.approx(float(parts))


def test_jumps_of_nested_switches_are_those_of_the_signals_that_decide_the_inner_ones():
    """The outer sign turns where the inner one does."""
    formula = gb.sign(gb.sign(z[0]) + 0.5 * gb.sign(z[1]))
    assert has_jumps(formula, z, z[0])
    assert not has_jumps(formula, z, z[2])
    assert has_jumps(gb.sign(z[0] - gb.sign(z[1])), z, z[1])


def interval(formula, at, slopes, sizes, length=0.5):
    symbols = ca.SX.sym("slopes", 3), ca.SX.sym("sizes", 3)
    function = ca.Function(
        "mean", [z, *symbols, p], list(interval_mean(formula, z, *symbols, length))
    )
    return [float(v) for v in function(at, slopes, sizes, 0.0)]


@pytest.mark.parametrize(
    ("formula", "z0", "slope", "size", "turn"),
    [
        (gb.sign(z[0]), 0.1, 0.0, 2.0, -0.1),  # 0.1 / 2 of half a second
        (gb.sign(z[0]), 0.1, 3.0, 4.0, -0.04),
        (gb.sign(z[0]), 0.1, -3.0, 4.0, 0.04),
        (gb.sign(z[0]), -0.1, 3.0, 4.0, 0.04),
        (gb.sign(2 * z[0]), 0.1, 3.0, 4.0, -0.04),
        (gb.sign(z[0]), 0.1, 3.0, 0.0, -0.2 / 3),
        (gb.sign(z[0] + 2 * z[1]), 0.1, 0.0, 3.0, -0.1 / (0.5 * np.hypot(3, 2 * 3))),
    ],
    ids=str,
)
def test_a_switch_turns_as_fast_as_its_argument_moves_and_its_signals_usually_do(
    formula, z0, slope, size, turn
):
    """So many intervals from the middle; integrals of ±1 and of the time before and after, less a 24th at both ends."""
    mean, moment = interval(formula, [z0, 0, 0], [slope, 0, 0], [size, size, 0])
    after = 1 if slope >= 0 else -1
    assert mean == pytest.approx(after * ((0.5 - turn) - (0.5 + turn)))
    integral = 0.5 * after * ((0.25 - turn**2) / 2 - (turn**2 - 0.25) / 2)
    assert moment == pytest.approx(integral - after * 2 * 0.5 / 24)


def test_an_interval_without_a_turn_has_the_value_in_its_middle():
    mean, moment = interval(gb.sign(z[0]) * z[1] ** 2, [1.0, 3.0, 0], [0.5, 0.2, 0], [0, 0, 0])
    assert mean == pytest.approx(9)
    assert moment == pytest.approx(0)
