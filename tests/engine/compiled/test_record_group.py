"""Records evaluated together give what they give one by one: trajectories, costs, condensed
systems, answers.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.compiled.record_group import Groups, RecordGroup

pytestmark = pytest.mark.usefixtures("unjudged_file")

TRUTH = {"a": 1.5, "b": 3.0, "c": 5.0, "delay": 0.031}


class Spring(gb.StateSpace):
    """x'' = -a x' - b x + c u(t - delay), position and velocity measured."""

    states = ("v", "x")
    inputs = ("u",)
    outputs = ("x", "v")
    delays = {"u": "delay"}
    a = gb.Parameter(1.0, bounds=(0.1, 10.0), unit="1/s")
    b = gb.Parameter(2.0, bounds=(0.1, 10.0), unit="1/s²")
    c = gb.Parameter(3.0, bounds=(0.1, 20.0), unit="1/s²")
    delay = gb.Parameter(0.02, bounds=(0.0, 0.1), unit="s")

    def derivative(self, x, u, p):
        return (-p.a * x.v - p.b * x.x + p.c * u.u, x.v)

    def output(self, x, u, p):
        return (x.x, x.v)


def record(seed, samples=150, step=0.02, hold=8, offset=0.0):
    """A record of the true spring with its own initial state, noise and bias of the first
    output.
    """
    random = np.random.default_rng(seed)
    time = step * np.arange(samples)
    u = np.repeat(random.standard_normal(samples // hold + 1), hold)[:samples]
    flown = gb.simulate(
        Spring(), TRUTH, gb.Record(time, {"u": u}), initial={"v": random.normal(), "x": 1.0}
    )
    noise = random.standard_normal((2, samples)) * np.array([[0.05], [0.1]]) * (1 + seed % 3)
    y = np.array([flown["x"] + offset, flown["v"]]) + noise
    y[0, 40:55] = np.nan
    return gb.Record(time, {"u": u, "x": y[0], "v": y[1]}, name=f"flight {seed}")


def records(**options):
    """Several records, one of them sampled twice as fast and one longer."""
    each = [{}, {"samples": 220}, {"step": 0.01, "hold": 20}, {}, {"samples": 90}]
    return [record(k, **(own | options)) for k, own in enumerate(each)]


CASES = {
    "shared": {},
    "own parameter": {"own": ("c",)},
    "own delay": {"own": ("delay",)},
    "biases": {"criterion": gb.OutputError(biases=("x",))},
    "full covariance": {"criterion": gb.OutputError(noise="full"), "own": ("a",)},
    "known noise": {"criterion": gb.OutputError(noise={"x": 0.1, "v": 0.1})},
    "known initial states": {
        "criterion": gb.OutputError(initial={"x": lambda p: p.c / 4}),
        "own": ("c",),
    },
}


def problem_of(case):
    options = CASES[case]
    return gb.several(Spring(), records(), **options)


@pytest.mark.parametrize("case", CASES)
def test_a_group_has_the_condensed_system_of_its_records(case):
    nlp = compile_problem(problem_of(case))
    groups = Groups(nlp.parts)
    assert len(groups.parts) <= 2  # one for every step between samples
    random = np.random.default_rng(1)
    z = nlp.scaling.to_solver(
        np.array([p.start for n, p in nlp.problem.parameters.items() if n in nlp.free])
    )
    z = z + 0.05 * random.standard_normal(z.size)
    each = [part.trajectory(z) for part in nlp.parts]
    each = [
        part.trajectory(z, 0.1 * random.standard_normal(t.nodes.shape))
        for part, t in zip(nlp.parts, each, strict=True)
    ]
    joined = groups.joined([t.nodes for t in each])
    together = [
        group.trajectory(z, nodes) for group, nodes in zip(groups.parts, joined, strict=True)
    ]
    assert_allclose(
        sum(group.cost(t, 0.0) for group, t in zip(groups.parts, together, strict=True)),
        sum(part.cost(t, 0.0) for part, t in zip(nlp.parts, each, strict=True)),
        rtol=1e-12,
    )
    for name in ("nodes", "ends", "gaps"):
        ours = groups.nodes_by_part([getattr(t, name) for t in together])
        for of_record, one in zip(ours, each, strict=True):
            assert_allclose(of_record, getattr(one, name), rtol=1e-9, atol=1e-11)
    for simulated in (False, True):
        systems = (
            [_system(part, t, simulated) for part, t in zip(parts, trajectories, strict=True)]
            for parts, trajectories in ((nlp.parts, each), (groups.parts, together))
        )
        alone, shared = (map(sum, zip(*system, strict=True)) for system in systems)
        for wanted, ours in zip(alone, shared, strict=True):
            assert_allclose(ours, wanted, rtol=1e-6, atol=1e-8 * np.abs(wanted).max())


def _system(part, trajectory, simulated):
    """Hessian, gradient and decrease of the nodes alone, exact in the continuity, whose scales
    do not matter then.
    """
    if simulated:
        trajectory = part.trajectory(trajectory.z, trajectory.nodes, simulated=True)
    linear = part.linearize(trajectory, part.residual_weight(trajectory))
    condensed = part.condense(linear, trajectory, np.zeros(2))
    return condensed.hessian, condensed.gradient, np.array(condensed.decrease)


def test_the_answer_is_that_of_records_one_by_one(monkeypatch):
    together = gb.fit(problem_of("biases"), starts=1, progress=False)
    monkeypatch.setattr("greybox.engine.compiled.record_part.RecordPart.group", None)
    alone = gb.fit(problem_of("biases"), starts=1, progress=False)
    assert_allclose(together.cost, alone.cost, rtol=1e-9)
    for name in together.free:
        assert (
            abs(together.estimate[name] - alone.estimate[name]) < 1e-4 * alone.standard_error[name]
        )
        assert together.standard_error[name] == pytest.approx(alone.standard_error[name], rel=1e-4)
    for one, other in zip(together.records, alone.records, strict=True):
        assert_allclose(one.residual("x"), other.residual("x"), atol=1e-5)


def test_records_of_equal_models_share_the_compiled_sample():
    """Also where every problem has a model of its own: what counts are the equations."""
    each = records()
    parts = compile_problem(sum(gb.Problem(Spring(), one) for one in each)).parts
    assert len({id(part.step) for part in parts}) <= 2
    other = compile_problem(
        gb.Problem(Spring(), each[0]) + gb.Problem(Spring(), each[1], delay="pade:2")
    ).parts
    assert other[0].step is not other[1].step


def test_records_share_the_sample_of_one_model_only_where_all_else_is_the_same_too():
    class Pushed(Spring):
        def __init__(self, force=1.0):
            self.force = force

        def derivative(self, x, u, p):
            return (-p.a * x.v - p.b * x.x + self.force * p.c * u.u, x.v)

    each = records()[:2]
    given = each[0].time, {name: each[0][name] for name in ("u", "x", "v")}
    held, unseen = (
        gb.Record(*given, hold={"u": 0.02}),
        gb.Record(given[0], {"u": given[1]["u"], "x": given[1]["x"]}),
    )
    method = gb.MultipleShooting(segment=10, integrator=gb.RungeKutta(1))

    def shared(first, second, record=each[1], **options):
        one, other = compile_problem(
            gb.Problem(first, each[0]) + gb.Problem(second, record, **options), method
        ).parts
        return one.step is other.step

    assert not shared(Pushed(2.0), Pushed(3.0))
    assert not shared(Pushed(), Spring())
    model = Pushed()
    assert shared(model, model)
    assert not shared(model, model, held)
    assert not shared(model, model, criterion=gb.OutputError(biases=("x",)))
    assert not shared(model, model, unseen)


@pytest.fixture(scope="module")
def mixed():
    """Three records and a response; the second record is another group by its parameter, the
    third by its step.
    """
    omega = np.array([1.0, 2.0, 4.0])
    response = gb.FrequencyResponse(omega, 1 / (1 + 1j * omega), "u", "x")
    each = [
        gb.Problem(Spring(), one)
        for one in (record(0), record(3, samples=300), record(2, step=0.01))
    ]
    problem = sum([*each[:2], gb.Problem(Spring(), response), each[2].with_(weight=2.0)])
    return compile_problem(problem, gb.MultipleShooting(segment=10, integrator=gb.RungeKutta(1)))


def test_groups_give_back_what_they_were_given(mixed):
    """Those of one step, one weight and one length of segments are one, whatever stands between
    them.
    """
    parts, groups = mixed.parts, Groups(mixed.parts)
    assert [isinstance(group, RecordGroup) for group in groups.parts] == [True, False, False]
    z = mixed.scaling.to_solver(np.ones(len(mixed.free)))
    trajectories = [part.trajectory(z, part.trajectory(z).nodes, simulated=True) for part in parts]
    nodes = [t.nodes for t in trajectories]
    joined = groups.joined(nodes)
    assert [len(own) for own in joined] == [45, 0, 15]
    for back, own in zip(groups.nodes_by_part(joined), nodes, strict=True):
        assert_allclose(back, own)
    together = [
        group.trajectory(z, own, simulated=True)
        for group, own in zip(groups.parts, joined, strict=True)
    ]
    for back, own in zip(groups.split(together), trajectories, strict=True):
        assert_allclose(back.nodes, own.nodes)
        assert_allclose(back.products, own.products, rtol=1e-9)
    spreads = [part.covariance.spread for part in parts[:2]]
    outputs = [
        part.simulated_outputs(t) for part, t in zip(parts[:2], trajectories[:2], strict=True)
    ]
    scaled = np.hstack(
        [values / spread[:, None] for values, spread in zip(outputs, spreads, strict=True)]
    )
    group = groups.parts[0]
    assert_allclose(np.sort(group.signature(together[0])), np.sort(scaled, axis=None), rtol=1e-9)
    nodes = group.trajectory(z).nodes
    initial = np.split(nodes, group.segments.first_of_record[1:])
    for one, part in zip(initial, parts[:2], strict=True):
        assert_allclose(one, part.trajectory(z).nodes)
