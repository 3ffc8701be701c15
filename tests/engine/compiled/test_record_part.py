"""A record's part against brute force: sensitivities by finite differences, condensing by one
dense system.
"""

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from evaluation import numeric_jacobian
from numpy.testing import assert_allclose
from scipy.linalg import expm
from spring_lag_tilt import HELD, SPRING, Spring, spring

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.compiled.record_part import RecordProgram
from greybox.engine.compiled.record_sensitivity import sensitivity


def compiled(record, criterion=HELD, **options):
    nlp = compile_problem(gb.Problem(Spring(), record, criterion, **options))
    z = nlp.scaling.to_solver(np.array([SPRING.get(name, 0.035) for name in nlp.free]))
    return nlp.parts[0], z, nlp


def part_of(record, criterion=HELD, **options):
    return compiled(record, criterion, **options)[:2]


@pytest.fixture(scope="module")
def made():
    """A part with a gap, a delay and a bias that are estimated, and a trajectory with gaps
    between its segments.
    """
    record = spring(120)
    record = record.with_signals(x=np.where(np.arange(120) % 7 == 3, np.nan, record["x"]))
    record = record.with_signals(F=np.where(np.arange(120) == 61, np.nan, record["F"]))
    part, z = part_of(record, gb.OutputError(inputs="held", biases=("x",)), free=("d",))
    nodes = part.trajectory(z).nodes + 0.1 * np.random.default_rng(0).normal(
        size=(part.data.segments, 2)
    )
    return part, z, part.trajectory(z, nodes)


def residuals(part, z, nodes):
    return part.residuals(part.trajectory(z, nodes)).ravel()


def gaps(part, z, nodes):
    trajectory = part.trajectory(z, nodes)
    return trajectory.gaps[part.data.coupled].ravel()


def dense(part, z, nodes, function):
    """Derivatives of a function of the nodes and z by both, nodes first."""
    by_nodes = numeric_jacobian(lambda v: function(part, z, v.reshape(nodes.shape)), nodes.ravel())
    by_z = numeric_jacobian(lambda v: function(part, v, nodes), z)
    return by_nodes, by_z


def test_a_continuous_trajectory_is_one_simulation(made):
    part, z, trajectory = made
    simulated = part.trajectory(z, trajectory.nodes, simulated=True)
    again = part.trajectory(z, simulated.nodes)
    assert (simulated.simulated, again.simulated) == (True, False)
    assert not simulated.gaps.any()
    assert np.abs(again.gaps).max() < 1e-12
    assert_allclose(again.products, simulated.products, rtol=1e-10)


def test_gaps_are_ends_less_the_next_nodes_and_none_crosses_a_break(made):
    part, _, trajectory = made
    assert (~part.data.coupled).sum() == 2
    assert_allclose(
        trajectory.gaps[:-1],
        np.where(part.data.coupled[:-1, None], trajectory.ends[:-1] - trajectory.nodes[1:], 0),
    )


def test_the_linearization_is_that_of_finite_differences(made):
    part, z, trajectory = made
    weight = part.initial_weight()
    linear = part.linearize(trajectory, weight)
    slope = trajectory.detail.slope
    by_nodes, by_z = dense(part, z, trajectory.nodes, residuals)
    W = np.kron(weight, np.eye(part.data.samples))
    e = W @ residuals(part, z, trajectory.nodes)
    J, Jz = W @ by_nodes, W @ by_z
    s, n = trajectory.nodes.shape
    full = J.T @ J
    for k in range(s):
        at = slice(k * n, (k + 1) * n)
        assert_allclose(
            linear.node_hessian[k], full[at, at], rtol=1e-4, atol=1e-5 * np.abs(full).max()
        )
        assert_allclose(
            linear.node_gradient[k], J[:, at].T @ e, rtol=1e-4, atol=1e-5 * np.abs(J.T @ e).max()
        )
    assert_allclose(
        slope.T @ linear.parameter_hessian[0] @ slope,
        Jz.T @ Jz,
        rtol=1e-4,
        atol=1e-5 * np.abs(Jz.T @ Jz).max(),
    )
    assert_allclose(
        slope.T @ linear.parameter_gradient[0],
        Jz.T @ e,
        rtol=1e-4,
        atol=1e-5 * np.abs(Jz.T @ e).max(),
    )


@pytest.mark.parametrize("relaxed", [0.0, 0.3])
@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_condensing_is_the_dense_elimination(made, relaxed, damping):
    """Nodes and multipliers are eliminated as one dense Karush-Kuhn-Tucker system does it."""
    part, z, trajectory = made
    weight = part.initial_weight()
    variance = relaxed * np.array([1.0, 2.0])
    linear = part.linearize(trajectory, weight)
    condensed = part.condense(linear, trajectory, variance, damping)

    by_nodes, by_z = dense(part, z, trajectory.nodes, residuals)
    A, B = dense(part, z, trajectory.nodes, gaps)
    W = np.kron(weight, np.eye(part.data.samples))
    e, g = W @ residuals(part, z, trajectory.nodes), gaps(part, z, trajectory.nodes)
    J, Jz = W @ by_nodes, W @ by_z
    nodes, count = J.shape[1], len(g)
    penalty = np.diag(np.tile(variance, count // 2))
    H = J.T @ J + np.diag(condensed.damping.ravel())
    if damping and relaxed:
        P = np.linalg.inv(penalty)
        assert_allclose(
            condensed.damping.ravel(), damping * np.diag(J.T @ J + A.T @ P @ A), rtol=1e-3
        )
    elif damping:  # of the first states alone: continuity gives the others
        first = part.data.begins_stretch
        own = np.diag(J.T @ J).reshape(condensed.damping.shape)[first]
        assert_allclose(condensed.damping[first], damping * own, rtol=1e-3)
        assert not condensed.damping[~first].any()
    else:
        assert not condensed.damping.any()
    kkt = np.block([[H, A.T], [A, -penalty]])
    right = -np.block([[(J.T @ e)[:, None], J.T @ Jz], [g[:, None], B]])
    solution = np.linalg.lstsq(kkt, right, rcond=None)[0]
    step, follow = solution[:nodes, 0], solution[:nodes, 1:]
    multiplier, multiplier_follow = solution[nodes:, 0], solution[nodes:, 1:]

    moved, jumps = J @ step, g + A @ step
    decrease = -(J.T @ e) @ step - moved @ moved / 2
    if relaxed:
        decrease -= (jumps**2 - g**2) @ (1 / np.diag(penalty)) / 2
    assert condensed.decrease == pytest.approx(max(decrease, 0.0), rel=1e-4, abs=1e-7 * e @ e)
    linked = part.data.coupled
    size = np.abs(multiplier).max()
    assert_allclose(condensed.multiplier[linked].ravel(), multiplier, atol=1e-3 * size)
    size = np.abs(multiplier_follow).max()
    assert_allclose(
        condensed.multiplier_sensitivity[linked].reshape(count, -1),
        multiplier_follow,
        atol=1e-3 * size,
    )

    scale = np.abs(step).max()
    assert_allclose(condensed.node_step.ravel(), step, atol=1e-4 * scale)
    assert_allclose(
        condensed.node_sensitivity.reshape(nodes, -1),
        follow,
        rtol=1e-3,
        atol=1e-4 * np.abs(follow).max(),
    )
    hessian = Jz.T @ Jz + Jz.T @ J @ follow + B.T @ multiplier_follow
    gradient = Jz.T @ e + Jz.T @ J @ step + B.T @ multiplier
    assert_allclose(condensed.hessian, hessian, atol=1e-4 * np.abs(hessian).max())
    assert_allclose(condensed.gradient, gradient, atol=1e-4 * np.abs(gradient).max())


def test_gaps_are_closed_by_the_least_change_of_the_outputs(made):
    part, z, trajectory = made
    weight = part.initial_weight()
    linear = part.linearize(trajectory, weight)
    closed = part.close_gaps(linear, trajectory, 0 * linear.node_hessian)
    A, _ = dense(part, z, trajectory.nodes, gaps)
    by_nodes, _ = dense(part, z, trajectory.nodes, residuals)
    J = np.kron(weight, np.eye(part.data.samples)) @ by_nodes
    change = (closed - trajectory.nodes).ravel()
    assert_allclose(A @ change, -gaps(part, z, trajectory.nodes), atol=1e-6)
    null = np.linalg.svd(A)[2][np.linalg.matrix_rank(A) :]
    assert np.abs(null @ (J.T @ (J @ change))).max() < 1e-3 * np.abs(J.T @ (J @ change)).max()


def test_known_initial_states_follow_their_function_of_the_parameters():
    criterion = gb.OutputError(inputs="held", initial={"x": lambda p: p.b / p.k, "v": 0.0})
    part, z = part_of(spring(60), criterion)
    trajectory = part.trajectory(z)
    assert_allclose(trajectory.nodes[0], [SPRING["b"] / SPRING["k"], 0.0])
    weight = part.initial_weight()
    simulated = part.trajectory(z, trajectory.nodes, simulated=True)
    condensed = part.condense(part.linearize(simulated, weight), simulated, np.zeros(2))

    def cost(v):
        moved = part.trajectory(v, simulated.nodes, simulated=True)
        return np.array([part.squared_cost(moved, weight)])

    slope = numeric_jacobian(cost, z)[0]
    assert_allclose(condensed.gradient, slope, rtol=1e-5, atol=1e-5 * np.abs(slope).max())

    def errors(v):
        moved = part.trajectory(v, simulated.nodes, simulated=True)
        return (weight @ part.residuals(moved).reshape(len(weight), -1)).ravel()

    J = numeric_jacobian(errors, z)
    assert_allclose(condensed.hessian, J.T @ J, rtol=1e-4, atol=1e-5 * np.abs(J.T @ J).max())


def test_an_excerpt_and_a_refinement_are_parts_of_their_own(made):
    part, z, _ = made
    excerpt = part.excerpt(40)
    assert excerpt.data.samples < part.data.samples
    assert excerpt.substeps == part.substeps
    finer = part.refined(4)
    assert finer.substeps == 4 * part.substeps
    assert part.data.samples == 2 * (part.data.samples // 2)
    coarse, fine = (p.trajectory(z, p.trajectory(z).nodes).ends for p in (part, finer))
    assert 0 < np.abs(coarse - fine).max() < 1e-3


def test_other_outputs_make_the_part_of_the_record_that_has_them():
    record = spring(60)
    shifted = record.with_signals(
        x=record["x"] + 5.0
    )  # so far from zero that the first nodes are as measured
    part, z = part_of(record)
    before = part.trajectory(z)
    other = part.with_outputs([np.array([shifted[name] for name in part.outputs])]).trajectory(z)
    wanted = part_of(shifted)[0].trajectory(z)
    assert np.abs(wanted.nodes - before.nodes).max() > 1
    assert_allclose(other.nodes, wanted.nodes)
    assert_allclose(other.products, wanted.products)


def test_residuals_are_first_weighed_by_the_spread_of_their_signal(made):
    part, _, _ = made
    measured = np.concatenate([stretch.outputs for stretch in part.data.stretches], axis=1)
    spread = np.nanstd(measured, axis=1)
    assert_allclose(part.initial_weight(), np.diag(1 / (0.1 * spread)), rtol=1e-6)


def test_states_may_jump_by_what_moves_the_outputs_of_a_segment_by_three_spreads(made):
    part, _, trajectory = made
    linear = part.linearize(trajectory, part.initial_weight())
    curvature = np.mean([np.diag(H) for H in linear.node_hessian], axis=0)
    wanted = 30.0**2 * part.data.segment_length * len(part.outputs) / curvature
    assert_allclose(part.continuity_variance(linear), wanted)
    unseen = linear._replace(node_hessian=linear.node_hessian * np.diag([1.0, 0.0]))
    # What a state moves in the next segment counts where it moves nothing in its own.
    first, later = part.continuity_variance(unseen)
    passed_on = np.mean(linear.transition[:, 0, 1] ** 2)
    assert_allclose([first, later], [wanted[0], wanted[0] / passed_on], rtol=0.3)
    apart = unseen._replace(transition=linear.transition * np.eye(2))
    assert 0 < part.continuity_variance(apart)[1] < np.inf


@pytest.mark.parametrize("first", [0, 1])
def test_a_given_initial_state_is_that_of_the_first_sample_and_of_no_later_stretch(first):
    data = spring(60)
    u = data["F"].copy()
    u[[30, 0][: 1 + first]] = np.nan
    known, _ = part_of(data.with_signals(F=u), gb.OutputError(inputs="held", initial={"x": 0.0}))
    begins = known.known_states[:, 0]
    assert begins[0] == (not first)
    assert not begins[1:].any()
    assert known.data.begins_stretch.sum() == 2


def test_a_signature_is_of_up_to_500_samples_in_units_of_the_spread(made):
    part, _, trajectory = made
    found = part.signature(trajectory).reshape(len(part.outputs), -1)
    outputs = part.simulated_outputs(trajectory)
    assert_allclose(found, outputs / part.covariance.spread[:, None])
    long, z = part_of(spring(2300))
    simulated = long.trajectory(z)
    outputs = long.simulated_outputs(simulated)
    assert_allclose(
        long.signature(simulated).reshape(2, -1),
        outputs[:, :: outputs.shape[1] // 500] / long.covariance.spread[:, None],
    )


@pytest.mark.parametrize(("error", "explained"), [(0.0, True), (0.3, False)])
def test_white_residuals_explain_the_data_and_a_wrong_parameter_does_not(error, explained):
    part, z = part_of(spring(600))
    nodes = part.trajectory(z).nodes
    nodes[0] = 0.0
    assert part.explains_data(part.trajectory(z * (1 + error), nodes, simulated=True)) is explained


def test_facts_of_a_part(made):
    part, _, _ = made
    measured = np.concatenate([stretch.outputs for stretch in part.data.stretches], axis=1)
    assert part.numbers == np.isfinite(measured).sum()
    assert part.unknown_initial_states == 4  # two states of two stretches
    assert not part.is_static
    assert part.has_nodes
    assert part.has_states
    assert part.delays == {"d": ("F", "")}
    assert part.samples == part.data.segments * part.data.segment_length
    known, _ = part_of(spring(60), gb.OutputError(inputs="held", initial={"x": lambda p: 0.0}))
    assert known.unknown_initial_states == 1
    assert known.model.known_states.tolist() == [True, False]


def test_process_noise_reaches_the_outputs_as_jumps_of_the_states_do():
    """Of a linear model after any jump by the exponential of its matrix, missing samples filled."""
    record = spring(120)
    record = record.with_signals(x=np.where(np.arange(120) % 7 == 3, np.nan, record["x"]))
    part, z = part_of(record)
    trajectory = part.trajectory(z, part.trajectory(z).nodes)
    shocks = sensitivity(part, trajectory, part.initial_weight()).shocks()
    A = np.array([[0.0, 1.0], [-SPRING["k"], -SPRING["c"]]])
    wanted = np.stack([expm(A * t) for t in record.time - record.time[0]], axis=2)
    assert_allclose(-shocks, wanted, atol=0.02)  # residuals are measured less modeled outputs


def test_process_noise_of_an_unstable_model_has_no_spectrum():
    part, z = part_of(spring(120))
    unstable = z.copy()
    unstable[list(SPRING).index("c")] *= -3
    trajectory = part.trajectory(unstable, part.trajectory(unstable).nodes)
    assert sensitivity(part, trajectory, part.initial_weight()).shocks().shape[1] == 0


class Growing(gb.StateSpace):
    """One motion decays, another grows, and both states show both."""

    states = outputs = ("a", "b")
    inputs = ("u",)
    mix = gb.Parameter(0.5, bounds=(0.01, 1))

    def derivative(self, x, u, p):
        grows, decays = x.a + p.mix * x.b, -2 * (p.mix * x.a - x.b)
        return grows + p.mix * decays + u.u, p.mix * grows - decays

    def output(self, x, u, p):
        return (x.a, x.b)


@pytest.mark.parametrize("mix", [0.1, 0.35, 0.6])
def test_no_rounding_makes_a_motion_decay_that_grows_by_many_decades(mix):
    signals = np.random.default_rng(0).normal(size=(3, 400))
    record = gb.Record(0.1 * np.arange(400), dict(zip("uab", signals, strict=True)))
    nlp = compile_problem(gb.Problem(Growing(), record, HELD))
    part, z = nlp.parts[0], nlp.scaling.to_solver(np.array([mix]))
    weight = part.initial_weight()
    assert sensitivity(part, part.trajectory(z), weight).shocks().shape[1] == 0


STATED = {"x": 0.05, "v": 0.11}
INFORMED = {
    "stated noise": {"noise": STATED},
    "full covariance": {"noise": "full"},
    "known state": {"noise": STATED, "initial": {"x": lambda p: p.b / p.k}},
}


@pytest.fixture(scope="module", params=INFORMED)
def informed(request):
    """What a record says, and the regression that says so: one simulation by differences of
    parameters and states.
    """
    options = INFORMED[request.param]
    record = spring(120)
    record = record.with_signals(x=np.where(np.arange(120) % 7 == 3, np.nan, record["x"]))
    record = record.with_signals(F=np.where(np.arange(120) == 71, np.nan, record["F"]))
    if options["noise"] == "full":
        record = record.with_signals(v=np.where(np.isfinite(record["x"]), record["v"], np.nan))
    part, z, nlp = compiled(
        record, gb.OutputError(inputs="held", biases=("x",), **options), free=("d",)
    )
    begins = part.data.begins_stretch
    trajectory = part.trajectory(z, part.trajectory(z).nodes, simulated=True)
    weight = part.residual_weight(trajectory)

    def moved(v, first):
        nodes = trajectory.nodes.copy()
        nodes[begins] = first.reshape(2, 2)
        return part.trajectory(v, nodes, simulated=True)

    def rows(of):
        return (weight @ part.residuals(of)).ravel()

    first = trajectory.nodes[begins].ravel()
    by_first = numeric_jacobian(lambda v: rows(moved(z, v)), first)
    by_z = numeric_jacobian(lambda v: rows(moved(v, first)), z)
    follow = -np.linalg.lstsq(by_first, by_z, rcond=1e-10)[0]
    nodes = numeric_jacobian(lambda v: moved(v, first).nodes.ravel(), z)
    nodes = nodes + numeric_jacobian(lambda v: moved(z, v).nodes.ravel(), first) @ follow
    alone, direct = dense(
        part,
        z,
        trajectory.nodes,
        lambda *at: (weight @ residuals(*at).reshape(len(weight), -1)).ravel(),
    )
    x = nlp.scaling.to_parameters(z)
    scale = nlp.scaling.slope(x)
    values = nlp.all_values(x)
    return SimpleNamespace(
        part=part,
        trajectory=trajectory,
        found=part.information(nlp.names, values, (), trajectory, scale),
        is_full=options["noise"] == "full",
        is_known="initial" in options,
        weight=weight,
        measured=np.isfinite(part.data.measured),
        J=(by_z + by_first @ follow) * scale,
        by_first=by_first,
        nodes=nodes * scale,
        through=alone @ nodes * scale,
        direct=direct * scale,
        noticed=np.sqrt((alone**2).reshape(-1, part.data.segments, 2).sum(axis=(0, 1))),
        size=len(values),
    )


def test_information_is_that_of_a_regression_on_parameters_and_initial_states(informed):
    """Of stated deviations, the residuals show how large they are."""
    part, found, J, weight, measured = (
        informed.part,
        informed.found,
        informed.J,
        informed.weight,
        informed.measured,
    )
    p = J.shape[1]
    close = {"rtol": 1e-4, "atol": 1e-6 * np.abs(J).max() ** 2}
    assert_allclose((found.jacobian.T @ found.jacobian)[:p, :p], J.T @ J, **close)
    assert found.jacobian.shape[1] == informed.size
    assert not found.jacobian[:, p:].any()
    initial = 3 if informed.is_known else 4
    assert part.unknown_initial_states == initial
    assert found.numbers == measured.sum() - initial

    white = ((weight @ part.residuals(informed.trajectory)) ** 2).sum(axis=1) / measured.sum(axis=1)
    share = np.ones(2) if informed.is_full else white
    each = J.reshape(2, -1, p)
    meat = (
        sum(v * own.T @ own for v, own in zip(share, each, strict=True))
        * measured.sum()
        / found.numbers
    )
    one, root = found.spread(1.3)
    assert one == 1
    assert_allclose((root.T @ root)[:p, :p], 1.69 * meat, **close)


def test_initial_states_follow_the_parameters_that_are_told_apart_by_what_is_left(informed):
    found, p = informed.found, informed.J.shape[1]
    if not informed.is_known:  # whose own change counts as the parameters'
        lengths = np.sqrt((informed.through**2).sum(axis=0) + (informed.direct**2).sum(axis=0))
        assert_allclose(found.reach[:p], lengths, rtol=1e-4)
    begins = informed.part.data.begins_stretch
    changes = informed.nodes.reshape(len(begins), 2, p)[begins] * informed.noticed[:, None]
    assert list(found.initial) == (["v"] if informed.is_known else ["x", "v"])
    for name, rows in found.initial.items():
        assert_allclose(
            rows[:, :p], changes[:, "xv".index(name)], rtol=1e-3, atol=1e-4 * np.abs(changes).max()
        )


@pytest.mark.parametrize(
    ("delay", "free", "masked"),
    [
        (gb.Parameter(0.03, bounds=(0, 0.12)), True, 3),
        (gb.Parameter(0.03, bounds=(0, 0.12)), False, 1),
        (gb.Parameter(0.03, bounds=(0, np.inf), starts=(0, 0.18)), True, 4),
        (gb.Parameter(0.23, bounds=(0, np.inf), starts=(0, 0.18)), True, 5),
        (gb.Parameter(0.23, bounds=(0, np.inf)), True, 5),
    ],
    ids=["bound", "fixed", "start box", "start", "unbounded"],
)
def test_samples_that_the_longest_delay_reaches_are_not_compared(delay, free, masked):
    """At 0.05 s a sample, of the times at which an input moves from the first sample on."""
    model = type("Late", (Spring,), {"d": replace(delay, fixed=not free)})()
    record = spring(120, force=np.random.default_rng(0).normal(size=120))
    (part,) = compile_problem(gb.Problem(model, record, HELD)).parts
    assert part.data.stretches[0].masked == masked
    assert np.isnan(part.data.measured[:, :masked]).all()
    assert np.isfinite(part.data.measured[:, masked:120]).all()


def test_a_delay_is_discontinuous_where_a_held_input_reaches_what_is_compared_at_once():
    class Direct(Spring):
        outputs = ("x", "pull")

        def output(self, x, u, p):
            return (x.x, x.v + p.b * u.F)

    record = spring(60)
    both = record.with_signals(pull=record["v"])

    def found(data, **options):
        criterion = gb.OutputError(inputs=options.pop("inputs", "held"))
        method = gb.MultipleShooting(segment=10, integrator=gb.RungeKutta(1))
        problem = gb.Problem(
            Direct(), data, criterion, free=("d",), rename={"d": "late"}, **options
        )
        return compile_problem(problem, method).parts[0].delays

    assert found(both) == {"late": ("F", "pull")}
    assert found(both, inputs="linear") == {"late": ("F", "")}
    assert found(record) == {"late": ("F", "")}


def test_a_predictor_whose_noise_is_estimated_has_the_gradient_of_its_likelihood():
    """Of known initial states, so that one simulation has them all; the Fisher information is
    that of S and of e.
    """
    criterion = gb.PredictionError(
        process_noise=("v",), inputs="held", initial={"x": 0.1, "v": -0.2}
    )
    nlp = compile_problem(gb.Problem(Spring(), spring(80), criterion))
    values = SPRING | {"w_v": 0.4, "v_x": 0.06, "v_v": 0.09}
    (part,), z = nlp.parts, nlp.scaling.to_solver(np.array([values[name] for name in nlp.free]))
    nodes = part.trajectory(z).nodes

    def run(v):
        return part.trajectory(v, nodes, simulated=True)

    trajectory = run(z)
    weight = part.residual_weight(trajectory)
    condensed = part.condense(part.linearize(trajectory, weight), trajectory, np.zeros(2))
    gradient = numeric_jacobian(lambda v: np.array([part.cost(run(v))]), z)[0]
    assert_allclose(condensed.gradient, gradient, rtol=1e-4, atol=1e-5 * np.abs(gradient).max())
    J = numeric_jacobian(lambda v: (weight @ part.residuals(run(v))).ravel(), z)
    S = run(z).detail.filter.covariance
    change = numeric_jacobian(lambda v: run(v).detail.filter.covariance.ravel(), z).reshape(
        2, 2, -1
    )
    relative = np.einsum("ab,bcp->acp", np.linalg.inv(S), change)
    fisher = J.T @ J + 80 / 2 * np.einsum("abp,baq->pq", relative, relative)
    assert_allclose(condensed.hessian, fisher, rtol=1e-4, atol=1e-5 * np.abs(fisher).max())
    told = part.information(
        nlp.names, nlp.all_values(nlp.scaling.to_parameters(z)), (), trajectory, np.ones(len(z))
    )
    assert_allclose(
        (told.jacobian.T @ told.jacobian)[:6, :6],
        fisher,
        rtol=1e-4,
        atol=1e-5 * np.abs(fisher).max(),
    )
    root = np.linalg.cholesky(np.linalg.inv(fisher))
    by_errors = told.colored(root).meat
    # What the covariance of the errors says of their size is not lost beside their spectrum.
    assert np.all(np.linalg.eigvalsh(by_errors - root.T @ (fisher - J.T @ J) @ root) > -1e-6)


@pytest.mark.parametrize("sensors", [("x",), ("x", "v", "pull")])
def test_a_program_for_ipopt_begins_with_the_record_and_what_follows_is_the_likelihood(sensors):
    """Weights of the residuals, whatever the number of outputs, then the data, which stay where
    no delay has moved.
    """

    class Watched(Spring):
        outputs = sensors

        def output(self, x, u, p):
            return (x.x, x.v, p.k * x.x)[: len(sensors)]

    record = spring(24)
    record = record.with_signals(pull=6 * record["x"] + 0.1 * np.cos(np.arange(24.0)))
    method = gb.MultipleShooting(segment=6, integrator=gb.RungeKutta(1), ipopt=True)
    criterion = gb.OutputError(inputs="held", noise="full", initial={"v": 0.0})
    nlp = compile_problem(gb.Problem(Watched(), record, criterion, free=("d",)), method)
    (part,), values = nlp.parts, SPRING | {"d": 0.035}
    z = nlp.scaling.to_solver(np.array([values[name] for name in nlp.free]))
    symbol = ca.MX.sym("z", len(z))
    program = RecordProgram(part, symbol)
    trajectory = part.trajectory(z, part.trajectory(z).nodes, simulated=True)
    unknowns, w = program.initial_unknowns(trajectory), program.initial_parameters(z)
    measured = part.data.measured
    spread, count = np.nanstd(measured, axis=1), np.isfinite(measured[0]).sum()
    k = len(sensors)
    assert_allclose(w[: k * k].reshape(k, k), np.diag(10 / spread))

    evaluate = ca.Function(
        "f", [symbol, program.unknowns, program.parameters], [program.error, program.equations]
    )
    error, equations = (v.full().ravel() for v in evaluate(z, unknowns, w))
    errors = part.residuals(trajectory)
    assert_allclose(error, (np.diag(10 / spread) @ errors).ravel(order="F"), atol=1e-9)
    assert_allclose(equations, 0, atol=1e-9)
    moved = unknowns.copy()
    moved[1] += 0.3  # the velocity at the first sample, which is known
    assert np.abs(evaluate(z, moved, w)[1].full()).max() == pytest.approx(0.3, rel=0.5)

    cost, following, stayed = program.outcome(z, program.products(z, unknowns, w).full(), w)
    assert cost == pytest.approx(part.cost(trajectory))
    assert stayed
    weight = following[: k * k].reshape(k, k, order="F")
    assert_allclose(weight.T @ weight @ (errors @ errors.T) / count, np.eye(k), atol=1e-6)
    assert_allclose(following[k * k :], w[k * k :])
    later = z.copy()
    later[list(nlp.free).index("d")] *= 2  # past the next sample
    assert not program.outcome(later, program.products(later, unknowns, w).full(), w)[2]


@pytest.mark.parametrize(("missing", "is_enough"), [(9, True), (10, False)])
def test_a_steady_filter_needs_nine_tenths_of_the_samples_that_are_compared(missing, is_enough):
    """Of a hundred, 96: the longest delay reaches the others."""
    record = spring(100, force=np.random.default_rng(0).normal(size=100))
    holes = np.isin(np.arange(100), 10 + 7 * np.arange(missing))
    record = record.with_signals(x=np.where(holes, np.nan, record["x"]))
    criterion = gb.PredictionError(process_noise="v", inputs="held")
    problem = gb.Problem(Spring(), record, criterion, free=("d",), name="flight")
    (part,) = compile_problem(
        problem, gb.MultipleShooting(segment=10, integrator=gb.RungeKutta(1))
    ).parts
    assert part.data.stretches[0].masked == 4
    if is_enough:
        assert part.noise_model.step == pytest.approx(0.05)
    else:
        with pytest.raises(
            ValueError,
            match=r"^'flight' has x, v together at too few samples for process_noise, whose",
        ):
            _ = part.noise_model
