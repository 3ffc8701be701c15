"""Variable projection: the truth of noise-free data, and the best of a grid over the nonlinear unknowns."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from lagged_plant import TRUTH, Lagged, flown
from numpy.testing import assert_allclose
from scipy.optimize import minimize

import greybox as gb
from greybox.data.intersample import Intersample
from greybox.modeling.realization import dynamics
from greybox.regression.least_squares import Rows
from greybox.regression.linear_in_parameters import regressions
from greybox.regression.regressors import regressors
from greybox.regression.variable_projection import explained, project

START = np.array([-2.0, 1.0, 0.12, 0.01])  # a, b, tau, T


def made(noise=0.0, seed=0, **bounds):
    """The data of the regressions, the free parameters and where they start."""
    record = flown(1000)
    v = record["v"] + noise * np.random.default_rng(seed).normal(size=len(record))
    system = dynamics(Lagged())
    equations = regressions(system, ["u", "v"], {}, START)
    data = regressors(
        equations,
        record.with_signals(v=v),
        START,
        np.array([0.1]),
        {"u": Intersample(False)},
    )
    parameters = {
        name: replace(p, start=start, bounds=bounds.get(name, p.bounds))
        for (name, p), start in zip(Lagged.parameters.items(), START.tolist(), strict=True)
    }
    return data, parameters


@pytest.fixture(scope="module")
def noisy():
    """Data, parameters and their estimate."""
    data, parameters = made(noise=0.01)
    return data, parameters, project(data, parameters, START)


def scatter(found):
    """Standard errors of all unknowns for white residuals."""
    equation = found.search.rows(found.point).equation
    slopes = found.search.slopes(found.point, found.unknowns)
    weighted = found.weights[equation][:, None] * slopes
    return np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)))


def cost(data, tau, delay):
    """The sum of squares with the best linear parameters."""
    rows = data.rows(np.array([0.0, 0.0, tau, delay]))
    errors = rows.errors(rows.solution(np.ones(1), np.full(2, -np.inf), np.full(2, np.inf)))
    return float(errors @ errors)


def test_noise_free_data_give_the_truth():
    data, parameters = made()
    found = project(data, parameters, START)
    assert found.names == ("a", "b", "tau", "T")
    assert_allclose(found.values, TRUTH, rtol=0.02, atol=1e-3)
    assert found.at_bound == found.undetermined == ()
    assert found.equations[0].r_squared > 0.9999
    assert_allclose(found.vector[2:], found.values[2:])


def test_no_point_of_a_grid_is_better(noisy):
    data, _, found = noisy
    tau, delay = found.values[2:]
    best = cost(data, tau, delay)
    grid = [
        cost(data, tau * x, delay + y)
        for x in (0.8, 0.95, 1, 1.05, 1.2)
        for y in (-0.01, -0.002, 0, 0.002, 0.01)
    ]
    assert min(grid) >= best * (1 - 1e-9)
    assert best < min(cost(data, x, y) for x in (0.02, 0.1, 0.3) for y in (0.0, 0.05, 0.1))


def test_linear_parameters_are_those_of_least_squares(noisy):
    data, _, found = noisy
    rows = data.rows(found.vector)
    X, y = rows.slopes, rows.target - rows.base
    assert_allclose(found.values[:2], np.linalg.lstsq(X, y, rcond=None)[0], rtol=1e-8)
    error = y - X @ found.values[:2]
    assert found.equations[0].residual == pytest.approx(np.sqrt(np.mean(error**2)))
    assert 1 - found.equations[0].r_squared == pytest.approx(
        np.sum(error**2) / np.sum((y - y.mean()) ** 2), rel=1e-3
    )


def test_a_bound_that_excludes_the_truth_is_reached():
    data, parameters = made(tau=(0.08, 0.5))
    found = project(data, parameters, START)
    k = found.names.index("tau")
    assert found.at_bound == ("tau",)
    assert found.values[k] == pytest.approx(0.08, rel=1e-9)


def test_a_step_on_the_same_data_is_small_and_on_other_data_leads_to_their_estimate(noisy):
    data, parameters, found = noisy
    errors = scatter(found)
    assert np.all(np.abs(found.step(data)) < 0.01 * errors)
    other, _ = made(noise=0.01, seed=1)
    other = replace(other, bands=data.bands)
    wanted = project(other, parameters, found.vector).values - found.values
    assert_allclose(found.step(other), wanted, atol=0.1 * errors.max(), rtol=0.2)


def test_too_short_a_record_is_said():
    data, parameters = made()
    with pytest.raises(
        ValueError, match=r"no stretch without a gap is long enough: .* need .* at its ends"
    ):
        project(replace(data, lateness=100.0), parameters, START)


def test_at_a_bound_a_step_leaves_the_parameter_there_and_moves_the_others():
    data, parameters = made(noise=0.01, tau=(0.08, 0.5))
    found = project(data, parameters, START)
    assert found.at_bound == ("tau",)
    other, _ = made(noise=0.01, seed=1)
    other = replace(other, bands=data.bands)
    wanted = project(other, parameters, found.vector)
    step = found.step(other)
    assert step[found.names.index("tau")] == 0
    errors = scatter(found).max()
    assert_allclose(step, wanted.values - found.values, atol=0.1 * errors, rtol=0.2)


def test_a_start_that_is_almost_as_good_as_the_minimum_is_improved_too():
    """Errors of the sensor are most of the cost, so that a start beside the minimum costs little more."""
    data, parameters = made(noise=0.1)
    found = project(data, parameters, START)
    errors = scatter(found)
    beside = found.vector + np.array([0.0, 0.0, *(0.2 * errors[2:])])
    assert cost(data, *beside[2:]) < 1.5 * cost(data, *found.vector[2:])
    again = project(data, parameters, beside)
    assert_allclose(again.values, found.values, atol=0.05 * errors.min())


# --- two equations of two linear and two nonlinear unknowns in closed form


@dataclass(frozen=True, eq=False)
class Decay:
    """Two equations over three stretches: exponentials and waves with bases of their own, in place of a record."""

    targets: tuple[np.ndarray, ...]
    bands: tuple[float, ...] = (2.0, 5.0)
    lateness: float = 0.4
    step: float = 0.1
    time: np.ndarray = field(default_factory=lambda: 0.1 * np.arange(5.0))

    equations = SimpleNamespace(
        linear=("a", "b"),
        nonlinear=("tau", "w"),
        free=("b", "tau", "a", "w"),
        equations=tuple(SimpleNamespace(left=name, parameters=()) for name in "pq"),
    )

    def rows(self, p):
        _, tau, _, w = p
        made = [MODELS[k](t, tau, w) for k, t in zip(EQUATIONS, TIMES, strict=True)]
        base, slopes = (np.concatenate(part) for part in zip(*made, strict=True))
        numbers = np.repeat(EQUATIONS, [t.size for t in TIMES])
        columns = numbers, np.concatenate(self.targets), base, slopes
        return Rows(*(column if tau < 30 else column[:0] for column in columns))


EQUATIONS = (0, 1, 0)
TIMES = (np.linspace(0, 4, 60), np.linspace(0.5, 7, 90), np.linspace(5, 9, 40))
MODELS = (
    lambda t, tau, w: (0.3 * np.sin(w * t), np.column_stack([np.exp(-t / tau), np.cos(w * t)])),
    lambda t, tau, w: (2 - np.exp(-t / tau), np.column_stack([w * t, 5 + 0 * t])),
)
VALUES = {"a": 2.0, "b": -0.7, "tau": 1.7, "w": 3.1}
NOISE = (0.02, 0.3)


def decay(noise=1.0, seed=0, moved=None):
    """What is measured, of noise that is as large in each equation as in `NOISE`."""
    random, known = np.random.default_rng(seed), VALUES | (moved or {})
    targets = []
    for equation, t in zip(EQUATIONS, TIMES, strict=True):
        base, slopes = MODELS[equation](t, known["tau"], known["w"])
        clean = base + slopes @ [known["a"], known["b"]]
        targets.append(clean + noise * NOISE[equation] * random.normal(size=t.size))
    return Decay(tuple(targets))


def declared(**options):
    """The free parameters, in the order of the model, and where they start."""
    some = {"b": (0.1, (-5, 5)), "tau": (1.0, (0.2, 20)), "a": (1.0, (-9, 9)), "w": (2.7, (0.5, 6))}
    made = {name: gb.Parameter(start, bounds=bounds) for name, (start, bounds) in some.items()}
    made |= {name: replace(made[name], **more) for name, more in options.items()}
    return made, np.array([p.start for p in made.values()])


def jacobian(values):
    """The slopes of every block to a, b, tau and w by hand."""
    a, b, tau, w = values
    made = []
    for equation, t in zip(EQUATIONS, TIMES, strict=True):
        e, de = np.exp(-t / tau), t / tau**2 * np.exp(-t / tau)
        if equation == 0:
            to_w = 0.3 * t * np.cos(w * t) - b * t * np.sin(w * t)
            made.append(np.column_stack([e, np.cos(w * t), a * de, to_w]))
        else:
            made.append(np.column_stack([w * t, 5 + 0 * t, -de, a * t]))
    return made


@pytest.mark.parametrize(
    "options", [{}, {"tau": {"scale": "log"}}, {"w": {"bounds": (-np.inf, np.inf)}}]
)
def test_the_projection_is_the_likeliest_of_all_unknowns_at_once(options):
    """Against a search over all four by scipy with the logarithms of both sums of squares, and its slopes by hand."""
    data, (parameters, start) = decay(), declared(**options)
    found = project(data, parameters, start)
    assert found.names == ("a", "b", "tau", "w")

    def errors(values):
        a, b, tau, w = values
        rows = data.rows((b, tau, a, w))
        each = rows.errors(np.array([a, b]))
        return each[rows.equation == 0], each[rows.equation == 1]

    def likelihood(values):
        return sum(e.size * np.log(e @ e) for e in errors(values))

    best = minimize(
        likelihood, found.values, method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-12}
    ).x
    assert_allclose(found.values, best, rtol=1e-5)
    first, second = errors(found.values)
    spread = [e.residual for e in found.equations]
    assert_allclose(spread, [np.sqrt(np.mean(first**2)), np.sqrt(np.mean(second**2))])
    assert [e.rows for e in found.equations] == [100, 90]
    targets = np.concatenate([data.targets[0], data.targets[2]]), data.targets[1]
    wanted = [
        1 - e @ e / np.sum((y - y.mean()) ** 2)
        for e, y in zip((first, second), targets, strict=True)
    ]
    assert_allclose([e.r_squared for e in found.equations], wanted)

    slopes = found.search.slopes(found.point, found.unknowns)
    assert_allclose(slopes, np.vstack(jacobian(found.values)), rtol=1e-5, atol=1e-6)
    assert_allclose(found.weights, 1 / np.array(spread), rtol=1e-6)


def test_a_step_is_that_of_gauss_and_newton():
    """On data that a small move of the truth made, it is the move; what a bound holds does not take part in it."""
    clean, (parameters, start) = decay(noise=0.0), declared()
    found = project(clean, parameters, start)
    assert_allclose(found.values, list(VALUES.values()), rtol=1e-6)
    move = {"a": 2.0 + 3e-4, "b": -0.7 - 2e-4, "tau": 1.7 - 4e-4, "w": 3.1 + 1e-4}
    assert_allclose(found.step(decay(noise=0.0, moved=move)), [3e-4, -2e-4, -4e-4, 1e-4], rtol=0.01)

    parameters, start = declared(a={"bounds": (-9, 1.9)})
    found = project(decay(), parameters, start)
    assert found.at_bound == ("a",)
    assert found.values[0] == 1.9
    other = decay(seed=1)
    rows = other.rows(found.vector)
    weights = found.weights[rows.equation]
    slopes = weights[:, None] * np.vstack(jacobian(found.values))[:, 1:]
    right = weights * rows.errors(found.unknowns)
    wanted = [0, *np.linalg.lstsq(slopes, right, rcond=None)[0]]
    assert_allclose(found.step(other), wanted, rtol=1e-3)


@pytest.mark.parametrize(("high", "reached"), [(1.5, True), (4.0, False)])
@pytest.mark.parametrize("scale", ["linear", "log"])
def test_a_nonlinear_unknown_ends_at_its_bound_exactly_or_inside(high, reached, scale):
    parameters, start = declared(tau={"bounds": (0.2, high), "scale": scale})
    found = project(decay(), parameters, start)
    assert (found.at_bound == ("tau",)) == reached
    assert found.values[2] == pytest.approx(1.5 if reached else 1.7, rel=1e-12 if reached else 0.1)
    low, start = declared(tau={"bounds": (2.0, 25.0), "scale": scale, "start": 3.0})
    found = project(decay(), low, start)
    assert found.at_bound == ("tau",)
    assert found.values[2] == pytest.approx(2.0, rel=1e-12)


def test_a_search_from_good_points_finds_what_one_from_the_start_misses():
    """A wave of another frequency is a minimum too; where a bound is infinite there is no box to draw from."""
    parameters, start = declared(w={"start": 5.9})
    assert project(decay(), parameters, start).values[3] == pytest.approx(3.1, rel=0.01)
    parameters, start = declared(w={"start": 5.9, "bounds": (-np.inf, np.inf)})
    assert abs(project(decay(), parameters, start).values[3] - 3.1) > 1


def test_how_much_is_missing_of_a_record_that_is_too_short():
    data, (parameters, start) = decay(), declared(tau={"start": 35.0, "bounds": (0.2, 50)})
    needed = 2 * np.log(10) / (np.sin(np.pi / 8) * 2.0) + 0.4
    with pytest.raises(
        ValueError, match=f"record has 0.5 s, of which .* states need {needed:.3g} s at its ends"
    ):
        project(data, parameters, start)


def test_a_target_that_is_constant_has_no_share_that_is_explained():
    share = explained(np.array([2.0, 4.0, 9.0]), np.array([1.0, -1.0, 2.0]))
    assert share == pytest.approx(1 - 6 / 26)
    assert np.isnan(explained(np.ones(4), np.zeros(4)))
    assert np.isnan(explained(np.zeros(0), np.zeros(0)))
