"""Several segments at once, against single steps and against differences."""

import numpy as np
import pytest
from hardening_spring import Spring
from numpy.testing import assert_allclose

import greybox as gb
from greybox.engine.compiled.sample_step import sample_step
from greybox.engine.compiled.segments import Course, Segments
from greybox.modeling.realization import dynamics

COUNT, LENGTH = 3, 7


@pytest.fixture(scope="module")
def made():
    """The step, the initial states, the parameters and the data of every sample."""
    model = Spring()
    system = dynamics(model)
    step = sample_step(system, [False], tuple(model.parameters), gb.RungeKutta(), 2)
    random = np.random.default_rng(0)
    q = np.array([p.start for p in model.parameters.values()])
    rows = np.zeros((step.width, COUNT * LENGTH))
    rows[: -1 - 2 * len(system.outputs)] = random.normal(
        size=(step.width - 1 - 2 * len(system.outputs), COUNT * LENGTH)
    )
    rows[0] = 0  # whole samples of delay
    rows[-1] = 0.05
    return step, random.normal(size=(COUNT, 2)), q, rows


def by_steps(step, initial, q, rows):
    states, outputs = [], []
    for k in range(COUNT):
        x = initial[k]
        for j in range(LENGTH):
            following, _, y = (
                np.asarray(v).ravel() for v in step.function(x, q, rows[:, k * LENGTH + j])
            )
            states.append(x)
            outputs.append(y)
            x = following
    return np.reshape(states, (COUNT, LENGTH, -1)), np.reshape(outputs, (COUNT, LENGTH, -1))


def test_each_segment_runs_from_its_own_state(made):
    step, initial, q, rows = made
    segments = Segments(step, COUNT, LENGTH, np.zeros(0, dtype=int))
    data = segments.columns(rows)
    states, ends = segments.simulate(initial, q, data)
    outputs = segments.outputs(Course(states, q, data))
    wanted_states, wanted_outputs = by_steps(step, initial, q, rows)
    assert_allclose(segments.by_segment(states), wanted_states, rtol=1e-13)
    assert_allclose(segments.by_segment(outputs), wanted_outputs, rtol=1e-13)
    assert_allclose(segments.in_order(data), rows)
    last = np.asarray(step.function(wanted_states[-1, -1], q, rows[:, -1])[0]).ravel()
    assert_allclose(ends[-1], last, rtol=1e-13)


def test_few_long_segments_run_one_after_the_other_to_the_same_states(made):
    step, initial, q, rows = made
    repeated = np.tile(rows, (1, 4 * 10))
    length = repeated.shape[1] // 2
    active = np.zeros(0, dtype=int)
    long = Segments(step, 2, length, active)
    assert length > 10 * 2
    states, ends = long.simulate(initial[:2], q, long.columns(repeated))
    x = initial[1]
    for j in range(length):
        assert_allclose(long.by_segment(states)[1, j], x, rtol=1e-9, atol=1e-12)
        x = np.asarray(step.function(x, q, repeated[:, length + j])[0]).ravel()
    assert_allclose(ends[1], x, rtol=1e-9, atol=1e-12)


def test_sensitivities_are_differences(made):
    step, initial, q, rows = made
    active = np.array([1, 0])
    segments = Segments(step, COUNT, LENGTH, active)
    data = segments.columns(rows)
    states, _ = segments.simulate(initial, q, data)
    found = segments.output_sensitivities(Course(states, q, data))
    assert found.shape[:2] == (COUNT, LENGTH)
    h = 1e-6
    for column in range(4):
        ends = []
        for sign in (1, -1):
            x, p = initial.copy(), q.copy()
            if column < 2:
                x[:, column] += sign * h
            else:
                p[active[column - 2]] += sign * h
            ends.append(by_steps(step, x, p, rows)[1])
        assert_allclose(found[..., column], (ends[0] - ends[1]) / (2 * h), atol=1e-7)


def test_a_guarded_root_below_zero_leaves_the_solver_exact_derivatives():
    """Of sqrt(max(h, 0)) the slope at h < 0 is 0 times infinity; nothing leaves the tank there."""

    class Drained(gb.StateSpace):
        states, inputs, outputs = ("h",), ("u",), ("h",)
        k = gb.Parameter(1.0, bounds=(0.1, 10))

        def derivative(self, x, u, p):
            return (-p.k * gb.sqrt(gb.maximum(x.h, 0)),)

        def output(self, x, u, p):
            return (x.h,)

    system = dynamics(Drained())
    step = sample_step(system, [False], ("k",), gb.RungeKutta(), 1)
    segments = Segments(step, 1, LENGTH, np.array([0]))
    rows = np.zeros((step.width, LENGTH))
    rows[-1] = 0.05
    data = segments.columns(rows)
    states, _ = segments.simulate(np.array([[-1.0]]), np.ones(1), data)
    along = Course(states, np.ones(1), data)
    ends, residuals = segments.sensitivities(along, slice(None), np.eye(1))
    assert_allclose(ends[0, 0], [1, 0])
    assert_allclose(residuals[..., 1], 0, atol=1e-15)


@pytest.mark.parametrize("own", [False, True])
def test_sensitivities_of_outputs_below_a_guarded_root_are_those_of_the_step(own):
    """Of sqrt(max(h, 0)) the slope at h < 0 is 0 times infinity; an empty tank still fills by
    what flows in.
    """

    class Tank(gb.StateSpace):
        states, inputs, outputs = ("h",), ("u",), ("h", "jet")
        k = gb.Parameter(1.0, bounds=(0.1, 10))
        b = gb.Parameter(1.0, bounds=(0.1, 10))

        def derivative(self, x, u, p):
            return (p.b - p.k * gb.sqrt(gb.maximum(x.h, 0)),)

        def output(self, x, u, p):
            return (x.h, p.k * gb.sqrt(gb.maximum(x.h, 0)))

    system = dynamics(Tank())
    step = sample_step(system, [False], ("k", "b"), gb.RungeKutta(), 1)
    rows = np.zeros((step.width, 2 * 12))
    rows[-1] = 0.05
    low, k, b = -0.33, 1.3, 0.9  # from below zero, and from above; both end above
    options = {"records": np.array([0, 1]), "own": own} if own else {}
    segments = Segments(step, 2, 12, np.array([0, 1]), **options)
    data = segments.columns(rows)

    def run(change):
        q = np.array([k, b]) + change[1:]
        q = np.tile(q[:, None], (1, 2)) if own else q
        states, _ = segments.simulate(np.array([[low], [0.5]]) + change[0], q, data)
        return segments.by_segment(segments.outputs(Course(states, q, data))), states, q

    _, states, q = run(np.zeros(3))
    found = segments.output_sensitivities(Course(states, q, data))
    for column, change in enumerate(1e-6 * np.eye(3)):
        wanted = (run(change)[0] - run(-change)[0]) / 2e-6
        assert_allclose(found[..., column], wanted, rtol=1e-5, atol=1e-6)


def test_sensitivities_of_outputs_are_not_finite_where_the_simulation_is_not(made):
    step, initial, q, rows = made
    segments = Segments(step, COUNT, LENGTH, np.array([0]))
    data = segments.columns(rows)
    states, _ = segments.simulate(initial, q, data)
    states[:, 2 * COUNT + 1] = np.nan
    found = segments.output_sensitivities(Course(states, q, data))
    assert np.isfinite(found[[0, 2]]).all()
    assert not np.isfinite(found[1, 3:]).any()


def measured_rows(rows, outputs=1):
    """The data with the output measured at all samples but one."""
    rows = rows.copy()
    rows[-1 - outputs : -1] = 1.0
    rows[-1 - 2 * outputs : -1 - outputs] = np.random.default_rng(5).normal(
        size=(outputs, rows.shape[1])
    )
    rows[-2, 4] = 0.0
    return rows


def ends_and_residuals(step, initial, q, rows):
    """By single steps: states at the ends (s, n) and residuals (s, length, k); q (p, s) of
    every segment.
    """
    ends, residuals = [], []
    for k in range(COUNT):
        x = initial[k]
        for j in range(LENGTH):
            x, e, _ = (
                np.asarray(v).ravel() for v in step.function(x, q[:, k], rows[:, k * LENGTH + j])
            )
            residuals.append(e)
        ends.append(x)
    return np.array(ends), np.reshape(residuals, (COUNT, LENGTH, -1))


@pytest.mark.parametrize("records", [[0, 0, 0], [0, 0, 1]], ids=["one record", "two records"])
@pytest.mark.parametrize("batch", [2 * LENGTH, 20_000], ids=["in batches", "at once"])
def test_a_linearization_is_that_of_the_weighted_residuals(made, records, batch, monkeypatch):
    """Products of derivatives by differences; one of the parameters differs between the records."""
    monkeypatch.setattr("greybox.engine.compiled.segments.BATCH", batch)
    step, initial, q, rows = made
    rows, records = measured_rows(rows), np.array(records)
    many = records[-1] + 1
    active = np.array([1, 0])
    each = np.tile(q[:, None], (1, COUNT))
    each[1] += 0.3 * records
    segments = Segments(step, COUNT, LENGTH, active, records=records, own=True)
    data = segments.columns(rows)
    states, _ = segments.simulate(initial, each, data)
    residuals = segments.residuals(Course(states, each, data))
    k = residuals.shape[0]
    weight = np.random.default_rng(6).normal(size=(many, k, k))
    found = segments.linearize(Course(states, each, data), weight)
    _, plain = ends_and_residuals(step, initial, each, rows)
    assert_allclose(segments.by_segment(residuals), plain, rtol=1e-9, atol=1e-12)
    products = segments.products(residuals)
    assert_allclose(products, [sum(e.T @ e for e in plain[records == r]) for r in range(many)])

    slopes, transitions = [], []
    for column in range(4):
        moved = []
        for sign in (1e-6, -1e-6):
            x, p = initial.copy(), each.copy()
            if column < 2:
                x[:, column] += sign
            else:
                p[active[column - 2]] += sign
            moved.append(ends_and_residuals(step, x, p, rows))
        transitions.append((moved[0][0] - moved[1][0]) / 2e-6)
        slopes.append((moved[0][1] - moved[1][1]) / 2e-6)
    transition = np.moveaxis(transitions, 0, -1)
    of_each = weight[records]
    J = np.einsum("sab,slbv->slav", of_each, np.moveaxis(slopes, 0, -1))
    e = np.einsum("sab,slb->sla", of_each, plain)
    hessian, gradient = np.einsum("slav,slaw->svw", J, J), np.einsum("sla,slav->sv", e, J)

    def summed(values):
        return np.array([values[records == r].sum(axis=0) for r in range(many)])

    close = {"rtol": 1e-5, "atol": 1e-6 * np.abs(hessian).max()}
    assert_allclose(found.transition, transition[..., :2], **close)
    assert_allclose(found.parameter_sensitivity, transition[..., 2:], **close)
    assert_allclose(found.node_hessian, hessian[:, :2, :2], **close)
    assert_allclose(found.cross_hessian, hessian[:, :2, 2:], **close)
    assert_allclose(found.node_gradient, gradient[:, :2], **close)
    assert_allclose(found.parameter_hessian, summed(hessian[:, 2:, 2:]), **close)
    assert_allclose(found.parameter_gradient, summed(gradient[:, 2:]), **close)


def test_stretches_are_simulated_through_their_segments(made):
    """One of two segments and one of one, of a record each."""
    step, initial, q, rows = made
    rows = measured_rows(rows)
    segments = Segments(step, COUNT, LENGTH, np.zeros(0, dtype=int), records=np.array([0, 0, 1]))
    data = segments.columns(rows)
    states, ends = segments.simulate_stretches([2, 1], initial, q, data)
    joined = step.simulate(initial[0], q, rows[:, : 2 * LENGTH].T)
    assert_allclose(ends[:2], joined[[LENGTH, -1]])
    last = step.simulate(initial[2], q, rows[:, 2 * LENGTH :].T)
    assert_allclose(ends[2], last[-1])
    assert_allclose(segments.in_order(states).T, np.vstack([joined[:-1], last[:-1]]))


def test_the_mean_transition_is_that_of_samples_over_the_whole_record(made):
    """Of the outputs, not of the residuals."""
    step, initial, q, rows = made
    rows = measured_rows(rows)
    rows[-2] = 1.0
    segments = Segments(step, COUNT, LENGTH, np.zeros(0, dtype=int))
    data = segments.columns(rows)
    states, _ = segments.simulate(initial, q, data)
    transition, outputs = segments.mean_transition(Course(states, q, data))
    A, C = np.zeros((2, 2)), np.zeros((1, 2))
    for k in range(COUNT * LENGTH):
        x = segments.in_order(states)[:, k]
        for column, h in enumerate(1e-6 * np.eye(2)):
            more, less = (
                [np.asarray(v).ravel() for v in step.function(x + s * h, q, rows[:, k])]
                for s in (1, -1)
            )
            A[:, column] += (more[0] - less[0]) / 2e-6 / (COUNT * LENGTH)
            C[:, column] += (more[2] - less[2]) / 2e-6 / (COUNT * LENGTH)
    assert_allclose(transition, A, rtol=1e-6, atol=1e-8)
    assert_allclose(outputs, C, rtol=1e-6, atol=1e-8)
