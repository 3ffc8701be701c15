"""Each criterion against its formula in plain numpy, its readings, its Jacobian, and what it refuses."""

import casadi as ca
import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from evaluation import numeric_jacobian
from numpy.testing import assert_allclose
from scipy.optimize import least_squares, minimize_scalar
from scipy.special import hyp2f1
from scipy.stats import multivariate_t

import greybox as gb
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.formulation.frequency_criteria import evaluate

pytestmark = pytest.mark.usefixtures("unjudged_file")

RANDOM = np.random.default_rng(0)
N = len(TWO_LAGS_OMEGA)
COLUMNS = {"coherence": RANDOM.uniform(0.3, 1, N), "variance": RANDOM.uniform(0.01, 0.1, N)}
DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.1, columns=COLUMNS)
WRONG = {"K": 3.0, "T1": 0.5, "T2": 0.3, "tau": 0.2}
MODEL = gb.frequency_response(LagLagDelay(), WRONG, TWO_LAGS_OMEGA).response


def cifer(P, data):
    """The cost of CIFER in dB and degrees, point by point: Tischler and Remple, section 11.2."""
    total = 0.0
    for k in range(len(data)):
        weight = (1.58 * (1 - np.exp(-data.coherence[k]))) ** 2
        magnitude = 20 * np.log10(abs(P[k])) - 20 * np.log10(abs(data.response[k]))
        phase = np.degrees(np.angle(P[k])) - np.degrees(np.angle(data.response[k]))
        phase = (phase + 180) % 360 - 180
        total += weight * (1.0 * magnitude**2 + 0.01745 * phase**2)
    return 20 / len(data) * total


def relative_likelihood(P, data):
    """The negative log-density of circular normal errors of the best relative variance, found by search.

    Less what the density has of the variances of the data, as MaximumLikelihood leaves it out.
    """

    def negative(log_variance):
        variance = np.exp(log_variance) * np.abs(P) ** 2
        density = np.exp(-(np.abs(data.response - P) ** 2) / variance) / (np.pi * variance)
        return -np.sum(np.log(density))

    return minimize_scalar(negative, bracket=(-3, 0), tol=1e-13).fun - np.sum(
        np.log(np.pi * data.variance)
    )


FORMULAS = {
    gb.RelativeError(): lambda P, d: np.sum(np.abs(P - d.response) / np.abs(d.response)),
    gb.RelativeError(normalized="model"): lambda P, d: np.sum(np.abs(P - d.response) / np.abs(P)),
    gb.SquaredRelativeError(): lambda P, d: np.sum(
        np.abs(P - d.response) ** 2 / np.abs(d.response) ** 2
    ),
    gb.SquaredRelativeError(normalized="model"): lambda P, d: np.sum(
        np.abs(P - d.response) ** 2 / np.abs(P) ** 2
    ),
    gb.RelativeLikelihood(): relative_likelihood,
    gb.MagnitudePhase(): cifer,
    gb.MaximumLikelihood(): lambda P, d: np.sum(np.abs(P - d.response) ** 2 / d.variance),
}
criteria = pytest.mark.parametrize("criterion", list(FORMULAS), ids=repr)


@criteria
def test_cost_is_the_published_formula_in_numbers_and_in_casadi(criterion):
    expected = FORMULAS[criterion](MODEL, DATA)
    assert evaluate(criterion, MODEL, DATA) == pytest.approx(expected, rel=1e-12)
    re, im = ca.SX.sym("re", N), ca.SX.sym("im", N)
    compiled = ca.Function("cost", [re, im], [criterion.cost(Complex(re, im), DATA)])
    assert float(compiled(MODEL.real, MODEL.imag)) == pytest.approx(expected, rel=1e-12)


@criteria
def test_cost_of_the_data_themselves_is_zero(criterion):
    if (
        criterion == gb.RelativeLikelihood()
    ):  # of nothing it has the logarithm of a relative error of 1e-9
        expected = N * (1 + 2 * np.log(1e-9)) + np.sum(
            np.log(np.abs(DATA.response) ** 2 / DATA.variance)
        )
        assert evaluate(criterion, DATA.response, DATA) == pytest.approx(expected, rel=1e-9)
    else:
        assert evaluate(criterion, DATA.response, DATA) == pytest.approx(0, abs=1e-20)


def test_phases_are_compared_on_the_circle():
    data = gb.FrequencyResponse([1.0], [np.exp(1j * np.radians(179))])
    model = np.array([np.exp(-1j * np.radians(179))])
    expected = 20 * (1.58 * (1 - np.exp(-1))) ** 2 * 0.01745 * 2**2
    assert evaluate(gb.MagnitudePhase(), model, data) == pytest.approx(expected, rel=1e-9)


def test_without_coherence_every_point_counts_as_fully_coherent():
    bare = gb.FrequencyResponse(DATA.omega, DATA.response)
    full = gb.FrequencyResponse(DATA.omega, DATA.response, coherence=np.ones(N))
    assert evaluate(gb.MagnitudePhase(), MODEL, bare) == pytest.approx(
        cifer(MODEL, full), rel=1e-12
    )


def held_residuals(criterion, data, scale):
    """Real residuals whose derivative `jacobian` must be, with the normalization held at `scale`."""
    if isinstance(criterion, gb.MagnitudePhase):
        root = np.sqrt(20 / N) * 1.58 * (1 - np.exp(-data.coherence))

        def residuals(P):
            ratio = P / data.response
            return np.concatenate(
                [
                    root * 20 * np.log10(np.abs(ratio)),
                    root * np.sqrt(0.01745) * np.degrees(np.angle(ratio)),
                ]
            )

        return residuals
    along = np.exp(1j * np.angle(MODEL))
    errors = lambda P: (P - data.response) / (scale * along)  # noqa: E731
    return lambda P: np.concatenate([errors(P).real, errors(P).imag])


@criteria
def test_jacobian_is_the_derivative_of_the_residuals(criterion):
    def response(x):
        return gb.frequency_response(
            LagLagDelay(), dict(zip(WRONG, x, strict=True)), DATA.omega
        ).response

    x = list(WRONG.values())
    if isinstance(criterion, gb.MaximumLikelihood):
        scale = np.sqrt(DATA.variance)
    else:
        model = (
            getattr(criterion, "normalized", "measured") == "model"
            or criterion == gb.RelativeLikelihood()
        )
        scale = np.abs(MODEL) if model else np.abs(DATA.response)
    residuals = held_residuals(criterion, DATA, scale)
    sensitivity = numeric_jacobian(response, x, 1e-3)
    expected = numeric_jacobian(lambda y: residuals(response(y)), x, 1e-3)
    assert_allclose(criterion.jacobian(MODEL, sensitivity, DATA), expected, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    "criterion", [c for c in FORMULAS if c != gb.RelativeLikelihood()], ids=repr
)
def test_smoothing_moves_the_cost_up_and_by_at_most_n_sqrt_eps(criterion):
    numbers = Complex(MODEL.real, MODEL.imag)
    bare = criterion.cost(numbers, DATA)
    for eps in (1e-13, 1e-8, 1e-2):
        rise = criterion.cost(numbers, DATA, eps) - bare
        assert -1e-12 * bare <= rise <= N * np.sqrt(eps)
        exact = criterion.cost(Complex(DATA.response.real, DATA.response.imag), DATA, eps)
        assert exact == pytest.approx(
            N * np.sqrt(eps) if criterion.smoothed else 0, rel=1e-6, abs=1e-18
        )


@pytest.mark.parametrize(
    "criterion", [gb.RelativeError(), gb.SquaredRelativeError(), gb.MagnitudePhase()], ids=repr
)
def test_a_zero_response_is_refused_where_it_would_be_divided_by(criterion):
    data = gb.FrequencyResponse([1.0, 2.5], [1.0, 0.0], variance=[0.1, 0.1])
    with pytest.raises(
        ValueError, match=r"response is zero at omega = 2\.5 rad/s.*leave that point out"
    ):
        gb.Problem(LagLagDelay(), data, criterion)
    gb.Problem(LagLagDelay(), data, gb.MaximumLikelihood())


def test_maximum_likelihood_refuses_data_without_variance():
    bare = gb.FrequencyResponse(DATA.omega, DATA.response)
    with pytest.raises(
        ValueError, match=r"needs the variance of every point.*variance=.*or use RelativeError"
    ):
        gb.Problem(LagLagDelay(), bare, gb.MaximumLikelihood())
    assert np.isnan(evaluate(gb.MaximumLikelihood(), MODEL, bare))


@pytest.mark.parametrize("criterion", [gb.RelativeError, gb.SquaredRelativeError])
def test_unknown_normalization_is_refused(criterion):
    with pytest.raises(
        ValueError, match="normalized 'data' is not known: use 'measured' or 'model'"
    ):
        criterion(normalized="data")


def test_a_gain_is_biased_low_by_the_measured_normalization_and_high_by_the_models():
    sigma = (
        0.2  # the two gains have a closed form, with the bias -2 sigma² and 2 sigma² to first order
    )

    class Gain(gb.TransferFunction):
        K = gb.Parameter(1.0, bounds=(0.1, 10))

        def response(self, s, p):
            return p.K + 0 * s

    data = measured(Gain(), np.geomspace(0.1, 10, 400), {"K": 2.0}, noise=sigma, seed=5)
    squares = (gb.SquaredRelativeError(normalized=n) for n in ("measured", "model"))
    low, high, free = (
        gb.fit(gb.Problem(Gain(), data, criterion), starts=1).estimate["K"]
        for criterion in (*squares, gb.RelativeLikelihood())
    )
    size = np.abs(data.response)
    assert low == pytest.approx(
        np.sum(data.response.real / size**2) / np.sum(1 / size**2), rel=1e-6
    )
    assert high == pytest.approx(np.sum(size**2) / np.sum(data.response.real), rel=1e-6)
    assert low / 2 - 1 < -(sigma**2)
    assert high / 2 - 1 > sigma**2
    assert free == pytest.approx(np.mean(data.response.real), rel=1e-6)  # which has no bias


def test_variances_estimated_with_few_degrees_of_freedom_are_a_student_t():
    rng = np.random.default_rng(5)
    omega, measured = np.geomspace(1, 20, 6), rng.normal(size=6) + 1j * rng.normal(size=6)
    variance, dof = rng.uniform(0.5, 2.0, 6), np.array([2.0, 3.0, 4.0, 8.0, 20.0, 1e7])
    data = gb.FrequencyResponse(omega, measured, variance=variance, dof=dof)

    def expected(model):
        errors = np.stack([(model - measured).real, (model - measured).imag], axis=1)
        each = zip(errors, variance, dof, strict=True)
        return -sum(multivariate_t([0, 0], v / 2 * np.eye(2), df=nu).logpdf(e) for e, v, nu in each)

    def cost(model):
        return gb.MaximumLikelihood().cost(Complex(model.real, model.imag), data)

    models = [measured + 0.7 * (rng.normal(size=6) + 1j * rng.normal(size=6)) for _ in range(3)]
    for model in models[1:]:
        assert cost(model) - cost(models[0]) == pytest.approx(
            expected(model) - expected(models[0]), rel=1e-6
        )
    certain = gb.FrequencyResponse(omega, measured, variance=variance, dof=np.full(6, 1e9))
    known = gb.FrequencyResponse(omega, measured, variance=variance)
    a, b = (
        gb.MaximumLikelihood().cost(Complex(models[0].real, models[0].imag), d)
        for d in (certain, known)
    )
    assert a == pytest.approx(b, rel=1e-6)


def test_standard_errors_hold_for_variances_of_few_degrees_of_freedom():
    nu = 4.0
    omega = np.geomspace(0.5, 40, 30)
    truth = gb.frequency_response(LagLagDelay(), TWO_LAGS, omega).response
    size = 0.05 * np.abs(truth)
    standardized = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        response = truth + size * (rng.normal(size=30) + 1j * rng.normal(size=30))
        variance = 2 * size**2 * rng.chisquare(nu, 30) / nu
        data = gb.FrequencyResponse(omega, response, variance=variance, dof=np.full(30, nu))
        problem = gb.Problem(LagLagDelay(), data, gb.MaximumLikelihood())
        fit = gb.fit(problem, starts=[TWO_LAGS], profiles=False, progress=False)
        standardized += [
            (fit.estimate[n] - TWO_LAGS[n]) / fit.standard_error[n] for n in ("K", "T1")
        ]
    # 40 of them: 0.2 is 1.8 standard deviations; with the variances taken as exact it is 1.3 for
    # four degrees.
    assert 0.8 < np.sqrt(np.mean(np.square(standardized))) < 1.25


def test_smoothing_is_added_to_the_variance_of_the_relative_likelihood():
    squares = np.mean(np.abs(1 - DATA.response / MODEL) ** 2)
    rise = gb.RelativeLikelihood().cost(Complex(MODEL.real, MODEL.imag), DATA, 1e-2)
    rise -= evaluate(gb.RelativeLikelihood(), MODEL, DATA)
    assert rise == pytest.approx(N * np.log1p(1e-2 / squares), rel=1e-9)


def test_without_variances_the_relative_likelihood_does_not_depend_on_units():
    bare = gb.FrequencyResponse(DATA.omega, DATA.response)
    milli = gb.FrequencyResponse(DATA.omega, 1000 * DATA.response)
    costs = [
        evaluate(gb.RelativeLikelihood(), model, data)
        for model, data in ((MODEL, bare), (1000 * MODEL, milli))
    ]
    assert costs[0] == pytest.approx(costs[1], rel=1e-12)


def test_noise_free_data_are_fitted_by_the_relative_likelihood():
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS)
    found = gb.fit(
        gb.Problem(LagLagDelay(), data, gb.RelativeLikelihood()), starts=8, profiles=False
    )
    assert found.converged
    values = sorted(found.estimate[name] for name in TWO_LAGS)
    assert_allclose(values, sorted(TWO_LAGS.values()), rtol=1e-6)


def test_errors_of_magnitude_and_phase_are_as_the_coherence_says():
    """A third of the points with a coherence of 0.55: the spread of the estimates of 20 draws, and what is printed."""
    omega = np.geomspace(1, 60, 30)
    coherence = np.where(np.arange(30) % 3 == 0, 0.55, 0.97)
    sigma = np.sqrt(
        (1 - coherence) / coherence / 40
    )  # of a component, with 20 averages: Bendat and Piersol, 9.2
    truth = {"K": 2.0, "T": 0.1}
    random = np.random.default_rng(8)
    exact = gb.frequency_response(Lag(), truth, omega).response
    values, errors = [], []
    for _ in range(20):
        noise = sigma * (random.normal(size=30) + 1j * random.normal(size=30))
        data = gb.FrequencyResponse(omega, exact * (1 + noise), coherence=coherence)
        found = gb.fit(gb.Problem(Lag(), data, gb.MagnitudePhase()), starts=[truth], profiles=False)
        values.append([found.estimate[name] for name in truth])
        errors.append([found.standard_error[name] for name in truth])
    # The standard deviation of 20 draws is known to 1 / √40 = 16 %; with errors of one size it was
    # 1.6 times too large.
    assert_allclose(
        np.sqrt(np.mean(np.square(errors), axis=0)) / np.std(values, axis=0), 1.0, atol=0.4
    )


def test_a_coherence_that_was_rounded_to_one_leaves_finite_errors():
    rounded = gb.FrequencyResponse(
        DATA.omega, DATA.response, coherence=np.where(np.arange(N) % 2, 1.0, 0.9)
    )
    whole = gb.FrequencyResponse(DATA.omega, DATA.response, coherence=np.ones(N))
    bare = gb.FrequencyResponse(DATA.omega, DATA.response)
    fits = [
        gb.fit(gb.Problem(LagLagDelay(), data, gb.MagnitudePhase()), starts=[TWO_LAGS])
        for data in (rounded, whole, bare)
    ]
    errors = np.array([[fit.standard_error[name] for name in TWO_LAGS] for fit in fits])
    assert_allclose(errors[1], errors[2], rtol=1e-9)
    assert np.all((errors[0] > 0.3 * errors[2]) & (errors[0] < 3 * errors[2]))


OMEGA4 = np.array([0.5, 1.0, 2.0, 4.0])
MODEL4 = np.array([2.0, 1.5 - 1j, -1j, -0.2 - 0.1j])
MEASURED4 = MODEL4 * np.array([1.1, 0.9 + 0.1j, 1 - 0.2j, 1.05])
RELATIVE4 = MEASURED4 / MODEL4


def data4(**columns):
    return gb.FrequencyResponse(OMEGA4, MEASURED4, "u", "y", **columns)


@pytest.mark.parametrize("correction", [1.0, 1.5])
def test_what_magnitude_and_phase_make_of_errors(correction):
    """Of given variances as they stand; of relative sizes by the coherence, scaled by the residuals."""
    decibels, degrees = 20 / np.log(10), 180 / np.pi
    variance, coherence = np.array([0.04, 0.01, 0.02, 0.001]), np.array([0.9, 0.8, 0.6, 0.95])
    sizes = np.concatenate([np.full(4, decibels**2), np.full(4, 0.01745 * degrees**2)])
    criterion = gb.MagnitudePhase()
    for columns, shape in (
        ({"variance": variance}, variance / np.abs(MEASURED4) ** 2),
        ({"coherence": coherence}, (1 - coherence) / coherence),
        ({"coherence": np.ones(4)}, np.ones(4)),
        ({}, np.ones(4)),
        ({"coherence": coherence, "variance": variance}, variance / np.abs(MEASURED4) ** 2),
    ):
        data = data4(**columns)
        common = 20 / 4 * (1.58 * (1 - np.exp(-columns.get("coherence", np.ones(4))))) ** 2
        weight = np.tile(common, 2) * sizes
        s2 = shape / 2
        if "variance" not in columns:
            errors = common * np.abs(np.log(MODEL4 / MEASURED4)) ** 2
            s2 = s2 * errors.sum() / (common * shape).sum() * correction**2
        bread, meat = criterion.spread(MODEL4, data, correction)
        assert bread == 2
        assert_allclose(meat, 4 * weight * np.tile(s2, 2))
        assert_allclose(criterion.error_size(MODEL4, data), np.abs(MODEL4) * np.sqrt(shape))


@pytest.mark.parametrize("correction", [1.0, 1.3])
def test_what_the_likelihoods_make_of_errors(correction):
    variance = np.array([0.04, 0.01, 0.02, 0.001])
    squares = np.abs(MEASURED4 - MODEL4) ** 2 / variance
    likelihood = gb.MaximumLikelihood()
    bread, meat = likelihood.spread(MODEL4, data4(variance=variance), correction)
    assert bread == 2
    assert_allclose(meat, 2 * squares.mean() * correction**2)
    assert squares.mean() > 1
    assert_allclose(
        likelihood.spread(MODEL4, data4(variance=99 * variance), correction)[1], 2.0
    )  # never smaller
    dof = np.array([4.0, 8.0, 6.0, 20.0])
    scale = likelihood.noise_ratio(MODEL4, data4(variance=variance, dof=dof))
    # Where the likelihood of a common factor of the variances, with Student's t, has its maximum.
    assert np.mean((dof + 2) * squares / (dof * scale + 2 * squares)) == pytest.approx(1)
    _, meat = likelihood.spread(MODEL4, data4(variance=variance, dof=dof), correction)
    assert_allclose(meat, 2 * max(scale * correction**2, 1) * np.tile((dof + 2) / dof, 2))
    assert_allclose(likelihood.error_size(MODEL4, data4(variance=variance)), np.sqrt(variance))

    s2 = np.mean(np.abs(RELATIVE4 - 1) ** 2) / 2
    bread, meat = gb.RelativeLikelihood().spread(MODEL4, data4(), correction)
    assert bread == pytest.approx(1 / s2)
    assert_allclose(meat, correction**2 / s2)
    for criterion in (gb.RelativeLikelihood(), gb.RelativeError(), gb.SquaredRelativeError()):
        assert_allclose(criterion.error_size(MODEL4, data4()), np.abs(MODEL4))


def test_a_model_of_nothing_does_not_make_the_noise_infinite():
    """Below a hundredth of what was measured it is no noise that lies between them."""
    nothing = np.array([2.0, 1.5 - 1j, 0, -0.2 - 0.1j])
    found = gb.SquaredRelativeError().noise(nothing, data4())
    assert np.isfinite(found)
    assert 20 < found < 100  # one point of four at the hundredfold


@pytest.mark.parametrize(
    "criterion", [gb.RelativeError(), gb.MaximumLikelihood(), gb.MagnitudePhase()], ids=repr
)
def test_common_errors_of_the_data_are_a_condition(criterion):
    variance = np.full(4, 0.1)
    assert criterion.condition_on(data4(variance=variance)) == criterion.condition
    common = criterion.condition_on(data4(variance=variance, common_errors=[0.1 * MEASURED4]))
    assert common == f"{criterion.condition}, and the common errors of the data"


@pytest.mark.parametrize("criterion", [gb.RelativeError(), gb.SquaredRelativeError()], ids=repr)
def test_the_noise_does_not_depend_on_the_phase(criterion):
    random = np.random.default_rng(0)
    omega = np.arange(1.0, 13.0)
    model = np.exp(1j * omega / 3)
    measured = model * (1 + 0.1 * random.normal(size=12) + 0.1j * random.normal(size=12))
    sizes = [
        criterion.noise(turn * model, gb.FrequencyResponse(omega, turn * measured, "u", "y"))
        for turn in np.exp(1j * np.array([0.0, 2.0, 4.0]))
    ]
    assert sizes == pytest.approx([sizes[0]] * 3, rel=1e-9)
    assert 0.05 < sizes[0] < 0.2


def test_directions_of_correlated_errors_are_correlated_as_middleton_says():
    """E e₁ e₂* / |e₁ e₂| of circular normal errors is (π/4) k ₂F₁(1/2, 1/2; 2; k²)."""
    k = np.array([0.0, 1e-6, 0.9e-4, 1.1e-4, 0.01, 0.3, 0.8, 0.999, 1.0])
    found = gb.RelativeError().score_correlation(k)
    assert_allclose(found, np.pi / 4 * k * hyp2f1(0.5, 0.5, 2, k**2), rtol=1e-6, atol=1e-150)
    assert found[-1] == pytest.approx(1)
    assert_allclose(gb.SquaredRelativeError().score_correlation(k), k)


def test_the_mean_error_at_the_minimum_is_too_small_by_what_the_parameters_take():
    """Of n points and p parameters by the share p / (π n), of squared errors by p / 2n of the square."""
    errors = np.array([0.3 + 0.4j, -0.6j, 0.1, 0.5 - 1.2j, 0.2j])
    n, p = 5, 3
    correction = np.sqrt(2 * n / (2 * n - p))
    mean = (0.5 + 0.6 + 0.1 + 1.3 + 0.2) / 5
    assert gb.RelativeError().size_of(errors, 1.0) == pytest.approx(mean / np.sqrt(np.pi / 2))
    expected = mean / np.sqrt(np.pi / 2) / (1 - p / (np.pi * n))
    assert gb.RelativeError().size_of(errors, correction) == pytest.approx(expected)
    squares = 0.25 + 0.36 + 0.01 + 1.69 + 0.04
    assert gb.SquaredRelativeError().size_of(errors, correction) == pytest.approx(
        np.sqrt(squares / (2 * n - p))
    )


def test_stated_variances_weigh_the_points_by_default():
    """Of few points with errors of 1 to 17 %, a least-squares fit with these weights, and its errors."""
    omega = np.geomspace(0.5, 20, 7)
    data = measured(Lag(), omega, {"K": 2.0, "T": 0.3}, noise=0.0)
    size = np.geomspace(0.01, 0.17, 7) * np.abs(data.response)
    noise = size * (np.random.default_rng(3).normal(size=(7, 2)) @ [1, 1j]) / np.sqrt(2)
    data = gb.FrequencyResponse(
        omega, data.response + noise, data.input, data.output, variance=size**2
    )

    def weighted(values):
        K, T = values
        errors = (K / (1j * omega * T + 1) - data.response) / (size / np.sqrt(2))
        return np.append(errors.real, errors.imag)

    best = least_squares(weighted, [1.0, 1.0], xtol=1e-14, ftol=1e-14)
    covariance = np.linalg.inv(best.jac.T @ best.jac)
    # Residuals above the stated errors widen the intervals.
    scale = max(2 * best.cost / (14 - 2), 1.0)
    fit = gb.fit(gb.Problem(Lag(), data), starts=3, profiles=False, progress=False)
    assert [fit.estimate["K"], fit.estimate["T"]] == pytest.approx(best.x, rel=1e-5)
    errors = [fit.standard_error["K"], fit.standard_error["T"]]
    assert errors == pytest.approx(np.sqrt(scale * np.diag(covariance)), rel=0.02)
