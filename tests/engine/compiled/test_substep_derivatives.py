"""Derivatives substep by substep against differences, and a large model against SciPy."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import greybox as gb
from greybox.engine.compiled.sample_step import sample_step
from greybox.engine.compiled.segments import Course, Segments
from greybox.modeling.realization import dynamics
from greybox.modeling.traced_once import traced_once

pytestmark = pytest.mark.usefixtures("unjudged_file")

CELLS = 16


class Rod(gb.StateSpace):
    """A heated rod of 16 cells with losses that grow with the square of the temperature."""

    states = tuple(f"T{k}" for k in range(CELLS))
    inputs, outputs = ("power",), ("hot", "cold")
    delays = {"power": "delay"}
    k = gb.Parameter(6.0, bounds=(1, 30), starts=(3, 12))
    r = gb.Parameter(0.02, bounds=(1e-3, 1), starts=(0.01, 0.1))
    b = gb.Parameter(10.0, bounds=(1, 100), starts=(5, 20))
    delay = gb.Parameter(0.0, bounds=(0, 1), fixed=True)

    def derivative(self, x, u, p):
        """Return the rates of the temperatures."""
        T = [getattr(x, name) for name in self.states]
        T = [T[0], *T, T[-1]]
        rates = [
            p.k * (before - 2 * here + after) - p.r * here**2
            for before, here, after in zip(T, T[1:], T[2:], strict=False)
        ]
        return (rates[0] + p.b * u.power, *rates[1:])

    def output(self, x, u, p):
        """Return the temperatures at both ends."""
        return (x.T0, x.T15)


@pytest.mark.parametrize("own", [False, True])
@traced_once()
def test_derivatives_are_differences(own):
    model = Rod()
    system = dynamics(model)
    names = (*model.parameters, "K_T0_hot", "K_T0_cold")
    # The finer steps share what was built for the coarse ones.
    coarse, step = (
        sample_step(system, [False], names, gb.RungeKutta(), n, corrects_states=True)
        for n in (4, 9)
    )
    assert coarse.repeats
    assert step.repeats
    random = np.random.default_rng(0)
    count, length, active = 2, 3, np.array([1, 0, 3, 4])
    rows = random.normal(size=(step.width, count * length))
    rows[0], rows[-1] = 0, 0.5  # whole samples of delay, step
    q = np.array([6.0, 0.02, 10.0, 0.2, 0.3, 0.1])
    before, segments = (Segments(s, count, length, active, own=own) for s in (coarse, step))
    data, nodes = segments.columns(rows), random.normal(size=(count, CELLS))
    by_segment = np.repeat(q[:, None], count, axis=1) if own else q
    states, _ = segments.simulate(nodes, by_segment, data)
    along = Course(states, by_segment, data)
    weight = random.normal(size=(segments.k, segments.k))
    others, *_ = before.sensitivities(along, slice(None), weight)
    ends, residuals = segments.sensitivities(along, slice(None), weight)
    assert np.abs(ends - others).max() > 1e-4

    def run(node, values, segment):
        x, errors = node, []
        for row in rows[:, segment * length : (segment + 1) * length].T:
            x, error, _ = (np.asarray(value).ravel() for value in step.function(x, values, row))
            errors.append(error)
        return x, np.array(errors)

    h = 1e-6
    for column in (0, 7, 15, *range(CELLS, CELLS + 4)):
        for segment in range(count):
            moved = []
            for sign in (1, -1):
                node, values = nodes[segment].copy(), q.copy()
                if column < CELLS:
                    node[column] += sign * h
                else:
                    values[active[column - CELLS]] += sign * h
                moved.append(run(node, values, segment))
            end, error = ((up - down) / (2 * h) for up, down in zip(*moved, strict=True))
            assert_allclose(ends[segment, :, column], end, atol=1e-7)
            weighted = (error @ weight.T).ravel()
            assert_allclose(residuals[segment, :, column], weighted, atol=1e-7)


def test_a_rod_is_estimated_as_by_scipy():
    model, random = Rod(), np.random.default_rng(3)
    time = 0.5 * np.arange(40)
    power = np.repeat(random.choice([0.0, 1.0, 2.0], 8), 5)

    def simulated(p):
        def slope(t, T):
            wide = np.concatenate([T[:1], T, T[-1:]])
            rates = p[0] * np.diff(wide, 2) - p[1] * T**2
            rates[0] += p[2] * np.interp(t, time, power)
            return rates

        x, outputs = np.zeros(CELLS), []
        for begin, end in zip(time, [*time[1:], time[-1] + 0.5], strict=True):
            outputs.append(x[[0, -1]])
            x = solve_ivp(slope, (begin, end), x, "LSODA", rtol=1e-8, atol=1e-8).y[:, -1]
        return np.transpose(outputs)

    measured = simulated([8.0, 0.05, 12.0]) + 0.1 * random.normal(size=(2, 40))
    record = gb.Record(time, {"power": power, "hot": measured[0], "cold": measured[1]})
    at_rest = gb.OutputError(
        initial=dict.fromkeys(Rod.states, 0.0), noise={"hot": 0.1, "cold": 0.1}
    )
    fit = gb.fit(gb.Problem(model, record, at_rest), starts=1)
    end = least_squares(
        lambda p: (simulated(p) - measured).ravel(), [6.0, 0.02, 10.0], x_scale=[6, 0.02, 10],
        diff_step=1e-4, xtol=1e-6, ftol=1e-9
    )  # fmt: skip
    apart = (end.x - [*fit.estimate.values()][:3]) / [*fit.standard_error.values()][:3]
    assert np.abs(apart).max() < 0.02
