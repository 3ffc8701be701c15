"""The part of a manoeuvre's spectrum against finite differences, the end term at its best at
every point.
"""

import numpy as np
import pytest
from benchmark_module import benchmark
from evaluation import numeric_jacobian
from numpy.testing import assert_allclose

import greybox as gb
from greybox.data.spectral import transient_spectrum
from greybox.engine.compiled.compiled_problem import compile_problem

study = benchmark("transient_coverage")
MOVING = (8.0, (1.0, 2.0, 2.5, 3.0), [0.005, 0.01])
SHORT = study.ShortPeriod(), study.SHORT_PERIOD, study.short_period_record(*MOVING), "u", "q"
LATERAL = study.Lateral(), study.LATERAL, study.lateral_record(), ["da", "dr"], ["roll", "yaw"]


class Seat(gb.StateSpace):
    """A lag that is felt together with what drives it, directly and late."""

    states, inputs, outputs = ("x",), ("u", "w"), ("felt", "load")
    delays = {"u": "T"}
    k = gb.Parameter(2.0, bounds=(0.1, 20))
    b = gb.Parameter(3.0, bounds=(0.1, 20))
    d = gb.Parameter(1.0, bounds=(0.1, 20))
    e = gb.Parameter(0.5, bounds=(0.1, 20))
    T = gb.Parameter(0.1, bounds=(0.0, 0.5))

    def derivative(self, x, u, p):
        return (-p.k * x.x + p.b * u.u + 0.3 * u.w,)

    def output(self, x, u, p):
        return (1.7 * x.x + p.d * u.u, p.e * x.x - p.d * p.e * u.w)


def seat_record():
    """Of smooth inputs at 50 Hz, of which what is interpolated is far below the noise; it ends
    away from its begin.
    """
    t = 0.02 * np.arange(401)
    late = gb.Record(
        t,
        {"u": np.sin(t) ** 3 + 0.3 * t, "w": np.cos(1.7 * t) - 0.2 * t},
        hold={"u": 0.0, "w": 0.0},
    )
    felt = gb.simulate(Seat(), FELT, late)
    return late.with_signals(felt=felt["felt"], load=felt["load"])


FELT = {"k": 1.3, "b": 2.2, "d": 0.6, "e": 1.4, "T": 0.07}
DIRECT = Seat(), FELT, seat_record(), ["u", "w"], ["felt", "load"]
CASES = {
    "one output": (*SHORT, gb.OutputError()),
    "two of each": (*LATERAL, gb.OutputError()),
    "felt directly": (*DIRECT, gb.OutputError()),
    "two of each, correlated": (*LATERAL, gb.OutputError(noise="full")),
    "equation error of one output": (*SHORT, gb.EquationError()),
    "equation error of all states": (*LATERAL, gb.EquationError(noise="full")),
    "equation error in gusts, one output": (*SHORT, gb.EquationError(gusts=True)),
    "equation error in gusts, all states": (*LATERAL, gb.EquationError(gusts=True)),
}


@pytest.fixture(scope="module", params=CASES)
def made(request):
    model, truth, clean, inputs, outputs, criterion = CASES[request.param]
    noise = dict.fromkeys([outputs] if isinstance(outputs, str) else outputs, 0.005)
    record = study.measured(clean, noise, np.random.default_rng(3))
    nlp = compile_problem(
        gb.Problem(model, transient_spectrum(record, inputs, outputs, study.BAND), criterion)
    )
    (part,) = nlp.parts
    z = nlp.scaling.to_solver(np.array([{"T_gust": 1.5, **truth}[name] for name in nlp.free]))
    return nlp, part, z, part.trajectory(z, None)


@pytest.fixture
def equation_error(request):
    return request.node.callspec.params["made"].startswith("equation error")


def weighted_errors(part, z, weight):
    return (weight @ part.trajectory(z, None).detail.errors).ravel()


def test_the_gradient_is_that_of_the_cost(made):
    _, part, z, trajectory = made
    gradient, _ = part.linearize(trajectory, None)
    slope = numeric_jacobian(lambda v: np.array([part.cost(part.trajectory(v, None), 0.0)]), z)[0]
    assert_allclose(gradient, slope, rtol=1e-4, atol=1e-4 * np.abs(slope).max())


def test_the_information_is_that_of_errors_whose_end_term_follows(made):
    _, part, z, trajectory = made
    _, information = part.linearize(trajectory, None)
    weight = trajectory.detail.covariance.weight(trajectory.products)
    J = numeric_jacobian(lambda v: weighted_errors(part, v, weight), z)
    # A full covariance follows the end term too.
    rtol = 0.02 if trajectory.detail.covariance.correlated else 0.01
    assert_allclose(information, J.T @ J, rtol=rtol, atol=0.002 * np.abs(J.T @ J).max())


def numbers_of(part, at):
    """The negative log-likelihood of the outputs, from the errors and the determinants of what
    transforms them.
    """
    n = at.errors.shape[1]
    covariance = at.errors @ at.errors.T / n
    if not at.covariance.correlated:
        covariance = np.diag(np.diag(covariance))
    return (
        n / 2 * (np.linalg.slogdet(2 * np.pi * covariance)[1] + len(covariance)) - 2 * at.logarithms
    )


def test_the_cost_is_that_of_normal_errors(made, equation_error):
    _, part, _, trajectory = made
    at = trajectory.detail
    assert part.cost(trajectory, 0.0) == pytest.approx(numbers_of(part, at))
    assert part.numbers == at.errors.size
    # Its errors are those of the modelled outputs, and no end term makes them smaller.
    measured = np.array([part.data.outputs[name] for name in part.outputs])
    unit = np.sqrt(part.data.step * part.data.duration / 2)
    if not equation_error:
        left = (measured - at.modeled) / unit
        assert_allclose(at.errors, np.hstack([left.real, left.imag]), rtol=1e-9, atol=1e-12)
    weight = at.covariance.weight(trajectory.products)
    assert_allclose(at.weight, weight)
    slope = at.taken.T @ (weight @ at.errors).ravel()
    atol = 1e-4 * np.linalg.norm(weight @ at.errors)
    assert_allclose(slope, 0, atol=atol)
    signature = part.signature(trajectory)
    size = np.sqrt(np.mean(np.abs(measured) ** 2, axis=1))[:, None]
    assert_allclose(
        signature,
        np.concatenate([v.ravel() for v in ((at.modeled / size).real, (at.modeled / size).imag)]),
    )


def test_what_all_variances_have_in_common_is_no_information(made):
    _, part, _, trajectory = made
    at, k = trajectory.detail, len(part.outputs)
    lines = np.arange(at.errors.shape[1] // 2)
    mean = np.zeros((k, 2 * len(lines), 2))
    # The first value changes the variances of all lines alike, the second that of the first half.
    share = np.array([np.ones(len(lines)), lines < len(lines) / 2])
    change = np.einsum("xl,ab->labx", share, np.eye(k))
    _, variance, _ = part.fisher_root(at, mean, change)
    assert_allclose(variance[:, 0], 0, atol=1e-12)
    assert np.abs(variance[:, 1]).max() == pytest.approx(1, rel=0.1)


def test_the_information_of_the_values_is_that_of_the_search(made):
    nlp, part, z, trajectory = made
    x = nlp.scaling.to_parameters(z)
    found = part.information(tuple(nlp.free), x, tuple(range(len(x))), trajectory, np.zeros((0, 0)))
    factor = (nlp.scaling.to_parameters(z + 1e-6) - x) / 1e-6
    _, wanted = part.linearize(trajectory, None)
    information = found.jacobian.T @ found.jacobian
    assert_allclose(
        information * factor * factor[:, None], wanted, rtol=1e-4, atol=1e-6 * np.abs(wanted).max()
    )
    assert found.numbers == part.numbers - len(part.states)
    one, root = found.spread(2.0)
    assert one == 1
    assert_allclose(root.T @ root, information)


def test_the_spread_follows_the_size_of_the_errors_over_the_band(made, equation_error):
    nlp, part, z, trajectory = made
    x = nlp.scaling.to_parameters(z)
    found = part.information(tuple(nlp.free), x, tuple(range(len(x))), trajectory, np.zeros((0, 0)))
    _, variance = np.split(found.jacobian, [part.numbers])
    root = np.linalg.inv(np.linalg.qr(found.jacobian)[1])
    colored = found.colored(root)
    meat, dof = colored.meat, colored.dof
    # Of white errors this would be the identity. Twelve lines or more have some with larger errors
    # than others, all of the size of the noise.
    assert np.all(np.linalg.eigvalsh(meat) > 0)
    assert 0.3 < np.trace(meat) / len(meat) < 6
    assert 3 < dof < found.numbers
    assert variance.any() == equation_error
    assert part.has_states
