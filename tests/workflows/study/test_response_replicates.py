"""How data of replicates are drawn, by what chance says of the draws."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.fft import dct

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.covariance.covariance import accuracy_at
from greybox.engine.solve.interruption import limited
from greybox.engine.solve.runs import SEARCH_OVER
from greybox.statistics.neighbor_correlation import NeighborCorrelation
from greybox.workflows.study.replicates import Draws
from greybox.workflows.study.response_replicates import (
    DrawnResponse,
    ResponseReplicates,
    response_draws,
)


def draws(*, points=3, constants=(), root=(), **changes):
    """Draws of one part of so many points, without noise."""
    ones = np.ones(points, complex)
    part = DrawnResponse(1.0 + np.arange(points), ones, np.ones(points), deviation=0.0)
    root = np.zeros((0, 0)) if len(root) == 0 else root
    return Draws(0, (replace(part, **changes),), np.array(constants, float), root, "")


def measured_points(made, numbers):
    """The measured responses in replicates of one part: (replicates, points)."""
    return np.array([next(made.of(number)[1]) for number in numbers])


@pytest.mark.parametrize("dof", [None, 12.0])
def test_parametric_errors_are_normal_or_of_student_and_what_points_have_in_common_is_added(dof):
    """In proportion to the sizes, of one variance in both components; Student's is larger by f / (f - 2)."""
    made = draws(
        response=np.array([1.0, 2j, -3.0]),
        size=np.array([1.0, 0.5, 2.0]),
        deviation=0.3,
        dof=None if dof is None else np.full(3, dof),
        common=np.array([[0.4, 0.4j, 0.0]]),
    )
    errors = measured_points(made, range(4000)) - made.parts[0].response
    size = 0.3 * np.array([1.0, 0.5, 2.0]) * (1 if dof is None else np.sqrt(dof / (dof - 2)))
    assert errors.mean(axis=0) == pytest.approx(np.zeros(3), abs=0.04)
    assert errors.real.std(axis=0) == pytest.approx(np.hypot(size, [0.4, 0, 0]), rel=0.06)
    assert errors.imag.std(axis=0) == pytest.approx(np.hypot(size, [0, 0.4, 0]), rel=0.06)
    assert np.mean(errors[:, 0].real * errors[:, 1].imag) == pytest.approx(0.16, abs=0.02)
    assert np.mean(errors[:, 0].real * errors[:, 2].real) == pytest.approx(0, abs=0.02)
    assert [*measured_points(made, [3])[0]] == [*measured_points(made, [3])[0]]


def test_constants_of_an_earlier_fit_are_drawn_with_their_covariance():
    root = np.array([[0.3], [-0.6]])
    made = draws(constants=[5.0, 7.0], root=root)
    found = np.array([made.of(k)[0] for k in range(2000)])
    assert found.mean(axis=0) == pytest.approx([5, 7], abs=0.05)
    assert np.cov(found.T) == pytest.approx(root @ root.T, rel=0.1)


class Lag(gb.TransferFunction):
    input, output = "u", "y"
    K = gb.Parameter(2.0, bounds=(0.1, 10))
    T = gb.Parameter(0.5, bounds=(0.01, 10))

    def response(self, s, p):
        return p.K / (p.T * s + 1)


OMEGA = np.array([0.5, 1.0, 2.0, 4.0, 8.0])


def lag_draws(noise, criterion, x=(2.0, 0.5), fixed=None, **columns):
    """The draws at K = 2 and T = 0.5, the modelled response, and the residuals over it."""
    model = 2 / (0.5j * OMEGA + 1)
    random = np.random.default_rng(3)
    left = noise * (random.normal(size=5) + 1j * random.normal(size=5))
    data = gb.FrequencyResponse(OMEGA, model * (1 + left), "u", "y", **columns)
    nlp = compile_problem(gb.Problem(Lag(), data, criterion, fixed=fixed or {}))
    x = np.array(x)
    return response_draws(accuracy_at(nlp, x), 4), model, left


def test_residuals_of_several_parts_share_the_parameters():
    """Two parameters of five and four points: each part has its share of them, as in the standard errors."""
    sets = two_parts()
    _, made, (gain, lag) = runner_of(sets)
    dof = []
    for data, part in zip(sets, made.parts, strict=True):
        model = gain / (lag * 1j * data.omega + 1)
        squares = np.sum(np.abs((data.response - model) / model) ** 2)
        dof.append(squares / part.deviation**2)
    assert sum(dof) == pytest.approx(18 - 2)
    assert 8 < dof[0] < 10


@pytest.mark.parametrize(("fixed", "parameters"), [({}, 2), ({"K": 2.0}, 1)])
def test_residuals_are_enlarged_for_the_fitted_parameters(fixed, parameters):
    x = (2.0, 0.5)[len(fixed) :]
    made, model, left = lag_draws(0.05, gb.SquaredRelativeError(), x, fixed)
    assert_allclose(made.parts[0].response, model)
    assert_allclose(made.parts[0].size, np.abs(model))
    wanted = np.sqrt(np.sum(np.abs(left) ** 2) / (10 - parameters))
    assert made.parts[0].deviation == pytest.approx(wanted, rel=1e-6)
    assert (made.parts[0].dof, made.parts[0].common) == (None, None)


@pytest.mark.parametrize(("given", "believed"), [(1e-1, True), (1e-3, False)])
def test_given_variances_are_believed_where_residuals_are_smaller(given, believed):
    """And what the points have in common is no error of their own."""
    variance, dof = given**2 * np.arange(1.0, 6.0), np.full(5, 20.0)
    common = np.sqrt(variance * np.array([0.0, 0.5, 0.5, 0.99, 0.0]))[None]
    made, model, left = lag_draws(
        0.01, gb.MaximumLikelihood(), variance=variance, dof=dof, common_errors=common
    )
    size = np.sqrt(variance * [1.0, 0.5, 0.5, 0.1, 1.0])  # a tenth of the variance is left at least
    assert_allclose(made.parts[0].size, size)
    expected = np.sqrt(0.5 if believed else np.sum(np.abs(left * model / size) ** 2) / 8)
    assert made.parts[0].deviation == pytest.approx(expected, rel=1e-6)
    assert made.parts[0].dof.tolist() == dof.tolist()
    assert_allclose(made.parts[0].common, common)


def test_constants_have_the_covariance_of_the_fit_that_they_come_from():
    earlier = gb.fit(joint(two_parts()), starts=[{}], progress=False, profiles=False)
    made, *_ = lag_draws(0.05, gb.SquaredRelativeError(), (0.5,), {"K": earlier})
    assert_allclose(made.root @ made.root.T, [[earlier.standard_error["K"] ** 2]])


class Gains(Lag):
    """A lag with a gain of five factors."""

    A, B, C, D = (gb.Parameter(1.0, bounds=(0.1, 10)) for _ in range(4))

    def response(self, s, p):
        return p.A * p.B * p.C * p.D * super().response(s, p)


def test_constants_that_follow_one_another_have_a_singular_covariance():
    data = gb.FrequencyResponse(OMEGA, 2 / (0.5j * OMEGA + 1) * (1 + 0.05 * 1j**OMEGA), "u", "y")
    problem = gb.Problem(Gains(), data, gb.SquaredRelativeError(), fixed={"A": 1.0})
    sizes = {"T": 0.3, "B": 0.7, "C": 0.6, "D": 1.3}
    tied = {name: lambda p, size=size: size * p.K for name, size in sizes.items()}
    earlier = gb.fit(problem.with_(tied=tied), starts=[{}], progress=False, profiles=False)
    names = ["K", *sizes]
    nlp = compile_problem(problem.with_(fixed=dict.fromkeys(names, earlier), free=["A"]))
    x = np.ones(1)
    root = response_draws(accuracy_at(nlp, x), 4).root
    places = [nlp.constants.index(name) for name in names]
    covariance = (root @ root.T)[np.ix_(places, places)]
    assert_allclose(covariance, earlier.covariance_of(names), rtol=1e-6)


def test_data_that_are_fitted_exactly_have_no_errors_to_draw():
    with pytest.raises(ValueError, match="is fitted exactly"):
        lag_draws(0.0, gb.SquaredRelativeError())


@pytest.mark.parametrize("by_ipopt", [False, True])
def test_a_replicate_is_refitted_as_its_data_would_be(monkeypatch, by_ipopt):
    made, *_ = lag_draws(0.05, gb.SquaredRelativeError())
    nlp = compile_problem(
        gb.Problem(
            Lag(),
            gb.FrequencyResponse(OMEGA, made.parts[0].response, "u", "y"),
            gb.SquaredRelativeError(),
        )
    )
    runner = ResponseReplicates(nlp, made, np.array([2.0, 0.5]))
    assert runner.draws.of(3)[0].size == 0
    if by_ipopt:
        monkeypatch.setattr(ResponseReplicates, "_newton", None)
    (outcome,) = runner.run_together(np.array([[7.0]]))
    (measured,) = measured_points(made, [7])
    data = gb.FrequencyResponse(OMEGA, measured, "u", "y")
    assert outcome.converged
    assert outcome.iterations > 0
    assert (outcome.stage == "improved") is not by_ipopt
    assert outcome.estimate == pytest.approx(
        refitted(gb.Problem(Lag(), data, gb.SquaredRelativeError())), rel=1e-5
    )


def test_errors_of_neighbors_in_frequency_are_correlated_along_and_across_the_response():
    """Of points that are not in order, by the variances of cosines of two kinds of errors, of which each draw has one."""
    omega = np.array([3.0, 1.0, 4.0, 2.0])
    response = np.array([1.0, 2j, -3.0, 2 - 1j])
    size = np.array([1.0, 0.5, 2.0, 1.5])
    part = {"omega": omega, "response": response, "size": size, "deviation": 0.3}
    variances = np.array([[3.0, 0.6, 0.3, 0.1], [1.0, 1.0, 1.0, 1.0]])
    weight, scale = np.array([0.7, 0.3]), np.array([2.5, 1.0])
    neighbors = NeighborCorrelation(np.eye(2, 4), weight, scale, variances)
    made = draws(points=4, neighbors=neighbors, **part)
    errors = (measured_points(made, range(2000)) - response) / size
    turned = errors * np.exp(-1j * np.angle(response))
    cosines = dct(np.eye(4), axis=0, norm="ortho")
    by_frequency = cosines.T @ np.diag(weight * scale @ variances) @ cosines
    places = np.array([2, 0, 3, 1])
    wanted = 0.09 * by_frequency[np.ix_(places, places)]
    for component in (turned.real, turned.imag):
        assert component.T @ component / 2000 == pytest.approx(wanted, abs=0.025)
    assert turned.real.T @ turned.imag / 2000 == pytest.approx(np.zeros((4, 4)), abs=0.025)
    plain = draws(points=4, **part)
    errors = (measured_points(plain, range(2000)) - response) / size
    assert errors.real.T @ errors.real / 2000 == pytest.approx(0.09 * np.eye(4), abs=0.012)


def two_parts():
    """Two records of responses of one lag, of five and four points."""
    random, model = np.random.default_rng(6), 2 / (0.5j * OMEGA + 1)
    sets = []
    for points in (slice(0, 5), slice(1, 5)):
        noise = 0.05 * (random.normal(size=5) + 1j * random.normal(size=5))
        sets.append(
            gb.FrequencyResponse(
                OMEGA[points], (model * (1 + noise))[points], "u", "y", name=f"of {points}"
            )
        )
    return sets


def joint(sets):
    criterion = gb.SquaredRelativeError()
    return gb.Problem(Lag(), sets[0], criterion) + gb.Problem(Lag(), sets[1], criterion)


def refitted(problem):
    fit = gb.fit(problem, starts=[{}], progress=False, profiles=False)
    return [fit.estimate["K"], fit.estimate["T"]]


class Rounded(gb.SquaredRelativeError):
    """A criterion that accepts only numbers."""

    def cost(self, model, data, smoothing=0.0):
        weights = np.array([float(abs(value)) for value in data.response])
        return super().cost(model, data) * weights.max()


def test_a_criterion_that_accepts_only_numbers_is_refused():
    problem = gb.Problem(Lag(), two_parts()[0], Rounded())
    fit = gb.fit(problem, starts=2, progress=False)
    with pytest.raises(ValueError, match=r"^Rounded accepts only numbers, .* data\.response, abs"):
        gb.bootstrap(fit, 3, problem=problem, progress=False)


def runner_of(sets):
    nlp = compile_problem(joint(sets))
    x = np.array(refitted(joint(sets)))
    made = response_draws(accuracy_at(nlp, x), 4)
    return ResponseReplicates(nlp, made, x), made, x


def test_when_time_is_up_what_newtons_method_left_has_no_estimate(monkeypatch):
    monkeypatch.setattr(ResponseReplicates, "_newton", None)
    runner, _, _ = runner_of(two_parts())
    with limited(0.0):
        (outcome,) = runner.run_together(np.array([[5.0]]))
    assert (outcome.status, outcome.converged, outcome.iterations) == (SEARCH_OVER, False, 0)
    assert np.isnan(outcome.estimate).all()
