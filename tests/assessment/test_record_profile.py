"""Profiles of records and rows, against dense grids by scipy and fits with the parameter fixed."""

from types import SimpleNamespace

import numpy as np
import pytest
from lateral_aircraft import disturbed, doublets
from nist import FORMULAS, certified
from numpy.testing import assert_allclose
from scipy.optimize import least_squares
from scipy.stats import t as student
from spring_lag_tilt import SPRING, Spring, fit

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

TRUTH = {name: SPRING[name] for name in ("k", "c", "b")}
WIND = gb.PredictionError(process_noise=("v",), inputs="held")


@pytest.fixture(scope="module")
def windy():
    record = disturbed(
        Spring(), TRUTH, doublets(1, 150, 1.0, 1), 0.05, {"v": 0.3}, {"x": 0.05, "v": 0.15}, 1
    )
    return record, fit(gb.Problem(Spring(), record, WIND))


def dense_grid(name, parameter, level=0.95):
    """The ends of the interval where the F statistic of the squares, on a grid of six errors, crosses its limit."""
    known = certified(name)
    record = known.problem.data
    others = [key for key in known.values if key != parameter]
    dof = len(record["y"]) - len(known.values)
    limit, variance = student.ppf(0.5 + level / 2, dof), known.squares / dof

    def residual(x, value):
        p = SimpleNamespace(**{parameter: value}, **dict(zip(others, x, strict=True)))
        return FORMULAS[name](p, record["x"]) - record["y"]

    ends = []
    for direction in (-1, 1):
        x, roots = np.array([known.values[key] for key in others]), [0.0]
        grid = known.values[parameter] + direction * np.linspace(0, 7 * known.errors[parameter], 36)
        for value in grid[1:]:
            found = least_squares(
                residual, x, x_scale=np.abs(x), xtol=1e-12, ftol=1e-12, args=(value,)
            )
            x = found.x
            roots.append(np.sqrt(max(2 * found.cost - known.squares, 0) / variance))
            if roots[-1] > 1.3 * limit:
                break
        near = np.searchsorted(roots, limit)
        assert near < len(roots)
        places = slice(max(near - 2, 0), near + 2)
        ends.append(np.polyval(np.polyfit(roots[places], grid[: len(roots)][places], 2), limit))
    return ends


@pytest.mark.parametrize(
    ("name", "parameter"),
    [("Misra1a", "b2"), ("Rat42", "b3"), ("BoxBOD", "b2")],
)
def test_intervals_of_nists_problems_are_those_of_a_dense_grid(name, parameter):
    known = certified(name)
    found = gb.profile(fit(known.problem, [known.starts[1]]), parameter, problem=known.problem)
    assert_allclose(
        found[parameter].interval, dense_grid(name, parameter), atol=5e-3 * known.errors[parameter]
    )
    assert not found.warnings


def test_a_table_whose_standard_errors_mislead_is_profiled_unasked():
    known = certified("Nelson")
    found = fit(known.problem, [known.starts[1]], profiles=True)
    assert found.interval()["b2"][0] < 0
    # Where b2 is zero, b3 has no effect: its interval is not symmetric, either.
    assert [profile.name for profile in found.profiles.profiles] == ["b2", "b3"]
    assert found.profiles["b2"].interval[0] > 0


def test_refits_with_the_parameter_fixed_cost_as_much_at_both_ends(windy):
    record, found = windy
    profile = gb.profile(found, "w_v")["w_v"]
    low, high = profile.interval
    best = found.estimate["w_v"]
    assert high - best > 1.15 * (best - low)  # noise of few records is not known evenly
    limit = student.ppf(0.975, found.dof)

    def rise(value):
        problem = gb.Problem(Spring(), record, WIND, fixed={"w_v": value})
        near = {name: found.estimate[name] for name in found.free if name != "w_v"}
        held = fit(problem, [near])
        return np.sqrt(2 * (held.cost - found.cost))

    # Correlated prediction errors make the standard error larger than the curvature says.
    step = 0.3 * found.standard_error["w_v"]
    by_curvature = 2 * step / (rise(best - step) + rise(best + step))
    ratio = found.standard_error["w_v"] / by_curvature
    assert 1 < ratio < 1.5
    for end in (low, high):
        assert rise(end) == pytest.approx(limit * ratio, rel=0.03)


def test_a_constant_has_no_profile(windy):
    with pytest.raises(ValueError, match="has no quantity to profile 'd'"):
        gb.profile(windy[1], "d")


class Damped(gb.StateSpace):
    """The spring by its damping ratio."""

    states, inputs, outputs = ("x", "v"), ("F",), ("x", "v")
    k, b = Spring.k, Spring.b
    zeta = gb.Parameter(0.2, bounds=(0, 2))

    def derivative(self, x, u, p):
        return (x.v, -p.k * x.x - 2 * p.zeta * gb.sqrt(p.k) * x.v + p.b * u.F)

    def output(self, x, u, p):
        return (x.x, x.v)


class WithRatio(Spring):
    derived = {"zeta": lambda p: p.c / (2 * gb.sqrt(p.k))}


def test_the_profile_of_a_derived_quantity_is_that_of_the_parameter_in_another_model():
    record = disturbed(Spring(), TRUTH, doublets(1, 60, 1.0, 1), 0.05, {}, {"x": 0.3, "v": 0.5}, 1)
    rule = gb.OutputError(inputs="held")
    found = gb.profile(fit(gb.Problem(WithRatio(), record, rule)), "zeta")["zeta"]
    low, high = found.interval
    assert high - found.estimate > 1.15 * (found.estimate - low)
    profiled = gb.profile(fit(gb.Problem(Damped(), record, rule)), "zeta")["zeta"]
    assert_allclose(found.interval, profiled.interval, rtol=1e-5)
