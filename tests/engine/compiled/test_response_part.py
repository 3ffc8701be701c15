"""A frequency response as a part of a problem: what tells two runs apart, and where it is not
finite.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.compiled.part import Elsewhere
from greybox.statistics.neighbor_correlation import neighbor_correlation

OMEGA = np.array([0.5, 1.0, 3.0, 10.0])


class Lag(gb.TransferFunction):
    """A first-order lag whose gain is a root."""

    input, output = "u", "y"
    K = gb.Parameter(4.0, unit="1", bounds=(-10.0, 10.0))
    T = gb.Parameter(0.5, unit="s", bounds=(0.01, 10.0))

    def response(self, s, p):
        return gb.sqrt(p.K) / (1 + p.T * s)


def part_of_lag():
    measured = 2.5 / (1 + 0.4j * OMEGA)
    nlp = compile_problem(
        gb.Problem(Lag(), gb.FrequencyResponse(OMEGA, measured, input="u", output="y"))
    )
    return nlp, nlp.parts[0], measured


def test_the_signature_is_the_response_over_the_measured_one():
    nlp, part, measured = part_of_lag()
    found = part.signature(part.trajectory(nlp.scaling.to_solver(np.array([9.0, 0.7]))))
    expected = 3.0 / (1 + 0.7j * OMEGA) / np.abs(measured)
    assert_allclose(found, np.concatenate([expected.real, expected.imag]), rtol=1e-12)


def test_a_response_that_is_not_finite_is_told():
    nlp, part, _ = part_of_lag()
    assert part.trajectory(nlp.scaling.to_solver(np.array([4.0, 0.5]))).finite
    assert not part.trajectory(nlp.scaling.to_solver(np.array([-4.0, 0.5]))).finite


def test_costs_and_their_derivatives_are_those_of_the_criterion():
    """Σ |P/P̂ - 1|, with what rounds off its kink under the root, and without."""
    nlp, part, measured = part_of_lag()
    z = nlp.scaling.to_solver(np.array([5.0, 0.7]))
    trajectory = part.trajectory(z, None)
    errors = np.abs(np.sqrt(5.0) / (1 + 0.7j * OMEGA) / measured - 1)
    assert part.cost(trajectory, 0.0) == pytest.approx(errors.sum(), rel=1e-12)
    assert part.cost(trajectory, 1e-8) == pytest.approx(np.sqrt(errors**2 + 1e-8).sum(), rel=1e-12)
    assert part.cost(trajectory, 1e-2) == pytest.approx(np.sqrt(errors**2 + 1e-2).sum(), rel=1e-12)
    assert part.numbers == 8

    gradient, hessian = part.linearize(trajectory, None)

    def cost(v):
        return part.cost(part.trajectory(v, None), 1e-8)

    steps = 1e-5 * np.eye(2)
    assert_allclose(gradient, [(cost(z + h) - cost(z - h)) / 2e-5 for h in steps], rtol=1e-6)
    slopes = np.array(
        [(part.linearize(part.trajectory(z + h, None), None)[0] - gradient) / 1e-5 for h in steps]
    )
    values, vectors = np.linalg.eigh((slopes + slopes.T) / 2)
    assert_allclose(hessian, (vectors * np.abs(values)) @ vectors.T, rtol=1e-3)
    assert np.linalg.eigvalsh(hessian).min() > 0


def test_the_response_and_how_it_follows_the_values():
    _, part, _ = part_of_lag()
    values = np.array([9.0, 0.7])
    lag = 1 / (1 + 0.7j * OMEGA)
    assert_allclose(part.response(values), 3 * lag, rtol=1e-12)
    assert_allclose(
        part.sensitivity(values), np.transpose([lag / 6, -3j * OMEGA * lag**2]), rtol=1e-12
    )


def test_a_measured_zero_tells_no_runs_apart():
    measured = np.array([0.0, 2.0, 1.0, 0.5])
    data = gb.FrequencyResponse(OMEGA, measured, input="u", output="y", variance=np.full(4, 0.01))
    (part,) = compile_problem(gb.Problem(Lag(), data, gb.MaximumLikelihood())).parts
    assert_allclose(part.magnitude, [2e-12, 2.0, 1.0, 0.5])


def test_a_criterion_of_the_users_own_stays_behind():
    """Its class may be known in this process alone."""

    class Own(gb.RelativeError):
        pass

    for criterion, travels in ((gb.RelativeError(), True), (Own(), False)):
        data = gb.FrequencyResponse(OMEGA, 1 / (1 + 0.4j * OMEGA), input="u", output="y")
        (part,) = compile_problem(gb.Problem(Lag(), data, criterion)).parts
        assert part.travels_whole is travels
        assert isinstance(part.__getstate__()["criterion"], Elsewhere) is not travels


def informed(criterion, **columns):
    """What a response of the lag says at K = 5 and T = 0.7, and the parts of it by hand."""
    measured = 2.5 / (1 + 0.4j * OMEGA)
    data = gb.FrequencyResponse(OMEGA, measured, input="u", output="y", **columns)
    nlp = compile_problem(gb.Problem(Lag(), data, criterion))
    (part,), x = nlp.parts, np.array([5.0, 0.7])
    trajectory = part.trajectory(nlp.scaling.to_solver(x), None)
    found = part.information(tuple(nlp.free), x, (), trajectory, np.zeros((0, 0)))
    lag = 1 / (1 + 0.7j * OMEGA)
    model = np.sqrt(5.0) * lag
    return (
        part,
        trajectory,
        found,
        measured,
        model,
        np.transpose([lag / np.sqrt(20.0), -1j * OMEGA * np.sqrt(5.0) * lag**2]),
    )


def stacked(values):
    return np.concatenate([values.real, values.imag])


def test_what_a_likelihood_says_contains_the_errors_that_points_have_in_common():
    """Half of the variance in each component, less the common part; that moves all points
    together.
    """
    variance = np.array([0.04, 0.02, 0.03, 0.01])
    common = np.array([[0.1, 0.05j, 0.0, 0.05], [0.0, 0.1, 0.1j, 0.0]])
    part, trajectory, found, measured, model, slope = informed(
        gb.MaximumLikelihood(), variance=variance, common_errors=common
    )
    deviation = np.sqrt(variance)
    turned = np.exp(1j * np.angle(model)) * deviation
    J = stacked(slope / turned[:, None])
    assert_allclose(found.jacobian, J, rtol=1e-9, atol=1e-15)
    assert (found.part, found.numbers) == (part, 8)
    assert_allclose(found.reach, np.linalg.norm(J, axis=0))
    ratio = np.mean(np.abs(measured - model) ** 2 / variance)
    assert part.noise_ratio(trajectory) == pytest.approx(ratio)
    for correction in (1.0, 1.5):
        bread, root = found.spread(correction)
        assert bread == 2
        own = 2 * max(ratio * correction**2, 1) * (1 - (np.abs(common) ** 2).sum(axis=0) / variance)
        moved = 2 * J.T @ stacked(common.T / turned[:, None])
        meat = J.T @ (np.tile(own, 2)[:, None] * J) + moved @ moved.T
        assert_allclose(root.T @ root, meat, rtol=1e-9)
    assert not found.offset(1.0).any()


def test_relative_errors_have_a_bias_along_the_response_and_no_errors_in_common_by_default():
    part, _, found, measured, model, slope = informed(gb.SquaredRelativeError())
    turned = np.exp(1j * np.angle(model)) * np.abs(measured)
    assert_allclose(found.jacobian, stacked(slope / turned[:, None]), atol=1e-15)
    bias = part.criterion.gain_bias(part.criterion.noise(model, part.data, 1.2), 4)
    assert bias < 0
    assert_allclose(found.offset(1.2), bias * stacked(model / turned), rtol=1e-9, atol=1e-15)
    bread, root = found.spread(1.2)
    given, size = part.criterion.spread(model, part.data, 1.2)
    assert bread == given
    assert_allclose(root.T @ root, found.jacobian.T @ (size[:, None] * found.jacobian))


@pytest.mark.parametrize(
    "columns",
    [{}, {"common_errors": np.array([[0.1, 0.05j, 0.0, 0.05] * 5, [0.0, 0.1, 0.1j, 0.0] * 5])}],
)
@pytest.mark.parametrize("criterion", [gb.RelativeError(), gb.MaximumLikelihood()])
def test_neighbors_are_correlated_as_errors_are_in_units_of_their_size(criterion, columns):
    """Errors turned by the phase of the model, less what the fit took along some directions and
    what is common.
    """
    omega, random = np.geomspace(0.3, 12, 20), np.random.default_rng(1)
    lag = np.sqrt(5) / (1 + 0.7j * omega)
    slope = np.transpose([lag / 10, -1j * omega * lag / (1 + 0.7j * omega)])
    draws = random.normal(size=(2, 21))
    smooth = (draws[:, :-1] + 0.8 * draws[:, 1:]) * 0.08
    measured, variance = lag * (1 + smooth[0] + 1j * smooth[1]), np.linspace(0.02, 0.05, 20)
    data = gb.FrequencyResponse(
        omega, measured, input="u", output="y", variance=variance, **columns
    )
    nlp = compile_problem(gb.Problem(Lag(), data, criterion))
    part, x, root = nlp.parts[0], np.array([5.0, 0.7]), np.array([[0.3], [-0.2]])
    found = part.neighbors(x, root, 1.2)

    is_known = isinstance(criterion, gb.MaximumLikelihood)
    size = np.sqrt(variance) if is_known else np.abs(lag)
    turned = np.exp(-1j * np.angle(lag)) / size
    design = [slope @ root, *(data.common_errors[:, :, None] if columns else [])]
    design = turned[:, None] * np.hstack(design)
    ratio = np.mean(np.abs(measured - lag) ** 2 / variance) * 1.2**2 if is_known else None
    wanted = neighbor_correlation(
        turned * (measured - lag), np.vstack([design.real, design.imag]), ratio
    )
    assert 0.1 < found.mean < 0.9
    assert_allclose(found.powers, wanted.powers)
    assert_allclose(found.weight, wanted.weight, rtol=1e-6, atol=1e-12)
    assert_allclose(found.scale, wanted.scale, rtol=1e-6)
    told = part.information(
        tuple(nlp.free), x, (), part.trajectory(nlp.scaling.to_solver(x), None), np.ones(2)
    )
    errors = told.correlated(1.2, root, 30.0).neighbors
    assert errors.mean == pytest.approx(found.mean)
