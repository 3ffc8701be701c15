"""Bands of fitted responses against Monte Carlo by scipy, closed forms and differences; residuals."""

from dataclasses import replace

import numpy as np
import pytest
from gain_and_lag import Gain, Lag
from numpy.testing import assert_allclose
from scipy.optimize import least_squares
from scipy.stats import f, t

import greybox as gb
from greybox.assessment.response_band import ResponseBand, band_of, radius, t_quantile
from greybox.engine.covariance.known_directions import KnownDirections
from greybox.models.tilt import NonlinearTilt

OMEGA = np.geomspace(0.3, 12, 12)
GRID = np.geomspace(0.2, 20, 9)
SIZE = 0.1  # relative standard deviation of the errors, both components together
ONE = {"starts": [{}], "progress": False}
QUIET = {"starts": 2, "progress": False}


class DelayedLag(gb.TransferFunction):
    """A lag with a delay."""

    K = gb.Parameter(2.0, bounds=(0.1, 10))
    T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s")
    d = gb.Parameter(0.05, bounds=(0, 0.5), unit="s")

    def response(self, s, p):
        return p.K * gb.exp(-s * p.d) / (p.T * s + 1)


class TwoGains(DelayedLag):
    """The same, its gain a product."""

    A = gb.Parameter(1.0, bounds=(0.1, 10))

    def response(self, s, p):
        return p.A * super().response(s, p)


def lagged(p, omega):
    return p[0] * np.exp(-1j * omega * p[2]) / (1 + 1j * omega * p[1])


TRUTH = np.array([2.0, 0.5, 0.05])
EXACT = lagged(TRUTH, OMEGA)


def measured(seed, dof=None):
    error = np.random.default_rng(seed).normal(size=(2, OMEGA.size)) * SIZE / np.sqrt(2)
    response = EXACT * (1 + error[0] + 1j * error[1])
    given = {} if dof is None else {"dof": np.full(OMEGA.size, dof)}
    return gb.FrequencyResponse(
        OMEGA, response, "u", "y", variance=SIZE**2 * np.abs(EXACT) ** 2, **given
    )


@pytest.fixture(scope="module")
def likely():
    return gb.fit(gb.Problem(DelayedLag(), measured(0), gb.MaximumLikelihood()), **QUIET)


def test_the_band_of_known_errors_is_that_of_monte_carlo_by_scipy():
    def misfit(p, response):
        e = (response - lagged(p, OMEGA)) / (SIZE * np.abs(EXACT))
        return np.concatenate([e.real, e.imag])

    found = [
        least_squares(misfit, TRUTH, args=(measured(k).response,), method="lm").x
        for k in range(1, 301)
    ]
    spread = np.log(np.array([lagged(p, GRID) for p in found]) / lagged(TRUTH, GRID))
    exact = gb.FrequencyResponse(OMEGA, EXACT, "u", "y", variance=SIZE**2 * np.abs(EXACT) ** 2)
    band = gb.fit(gb.Problem(DelayedLag(), exact, gb.MaximumLikelihood()), **ONE).response_band(
        GRID
    )
    assert_allclose(band.relative_error[0], spread.real.std(axis=0), rtol=0.12)  # of 300 draws: 4 %
    assert_allclose(band.relative_error[1], spread.imag.std(axis=0), rtol=0.12)
    held = np.abs(spread.imag) <= band.half_width[1]
    assert 0.92 <= held.mean() <= 0.98


def test_the_band_of_relative_errors_covers():
    truth = lagged(TRUTH, GRID)
    held = []
    for seed in range(10):
        band = gb.fit(gb.Problem(DelayedLag(), measured(seed)), **ONE).response_band(GRID)
        low, high = band.magnitude
        held.append((low <= np.abs(truth)) & (np.abs(truth) <= high))
    # Nine frequencies that depend on three parameters, in 10 fits.
    assert np.mean(held) >= 0.8


def test_limits_ellipses_and_quantiles_are_those_of_the_covariance(likely):
    band = likely.response_band(GRID, level=0.9)
    center = band.response.response
    size = np.abs(center)
    assert_allclose(np.sqrt(band.magnitude[0] * band.magnitude[1]), size)
    half = t.ppf(0.95, min(band.dof, 1e9)) * band.relative_error
    assert_allclose(np.log(band.magnitude[1] / size), half[0])
    assert_allclose(band.half_width[1], half[1])
    assert_allclose(band.phase, np.angle(center) + np.array([-half[1], half[1]]))
    away = band.ellipses() - center[:, None]
    both = np.array([away.real, away.imag])
    squares = np.einsum("ink,nij,jnk->nk", both, np.linalg.inv(band.covariance), both)
    assert_allclose(squares, radius(0.9, band.dof) ** 2, rtol=1e-6)


@pytest.mark.parametrize("dof", [2, 7.5, 1e7])
def test_the_region_of_two_components_is_fishers(dof):
    assert_allclose(radius(0.95, dof) ** 2, 2 * f.ppf(0.95, 2, dof), rtol=1e-5)
    assert_allclose(radius(0.95, np.inf) ** 2, -2 * np.log(0.05))


def test_a_response_is_determined_where_its_parameters_are_not(likely):
    product = gb.fit(gb.Problem(TwoGains(), measured(0), gb.MaximumLikelihood()), **QUIET)
    assert np.isnan(product.standard_error["K"])
    one, other = (fit.response_band(GRID) for fit in (likely, product))
    assert_allclose(other.relative_error, one.relative_error, rtol=1e-3)


def test_what_the_data_leave_open_has_no_band():
    # At 1e-6 rad/s the lag and the delay would still show, by shifting the minimum to a bound.
    constant = gb.FrequencyResponse([1e-9, 2e-9], [2.0, 2.02], "u", "y")
    fit = gb.fit(gb.Problem(DelayedLag(), constant), **QUIET)
    band = fit.response_band([1e-9, 10.0])
    assert np.isfinite(band.relative_error[:, 0]).all()
    assert np.isnan(band.relative_error[:, 1]).any()
    assert np.isnan(band.ellipses()[1]).all()


def test_ties_bounds_and_earlier_fits_are_in_the_band(likely):
    data = measured(0)
    free = gb.Problem(TwoGains(), data, gb.MaximumLikelihood(), fixed={"K": 2.0})
    tied = gb.Problem(TwoGains(), data, gb.MaximumLikelihood(), tied={"K": lambda p: p.A})
    one, other = (gb.fit(problem, **QUIET).response_band(GRID) for problem in (free, tied))
    assert_allclose(other.relative_error, one.relative_error, rtol=1e-3)
    assert_allclose(one.relative_error, likely.response_band(GRID).relative_error, rtol=1e-3)

    gains = gb.fit(gb.Problem(Gain(), gb.FrequencyResponse([1.0, 2.0], [2.0, 2.1])), **QUIET)
    held = gb.fit(gb.Problem(Lag(), data, fixed=gains), **QUIET)
    known = gb.fit(gb.Problem(Lag(), data, fixed=dict(gains.estimate)), **QUIET)
    wide, narrow = (fit.response_band([0.01]).relative_error[0, 0] for fit in (held, known))
    assert_allclose(
        wide, np.hypot(narrow, gains.standard_error["k"] / gains.estimate["k"]), rtol=1e-3
    )

    bounded = gb.fit(
        gb.Problem(DelayedLag(), data, constraints=[lambda p: 0.5 - 10 * p.d]), **QUIET
    )
    assert np.isfinite(bounded.response_band(GRID).relative_error).all()


@pytest.mark.parametrize(
    ("model", "name", "options"),
    [
        (DelayedLag(), "d", {"delay": "pade:3"}),
        (NonlinearTilt(), "C_x", {"at": {"theta": 0.0873}}),
    ],
)
def test_derivatives_are_those_of_differences(model, name, options):
    omega = np.array([1.0, 2.5])
    start = model.parameters[name].start or 0.3
    others = {other: p.start for other, p in model.parameters.items() if other != name}

    def response(value):
        values = {**others, name: value}
        output = model.output_names[0]
        return gb.frequency_response(model, values, omega, output=output, **options).response

    data = gb.FrequencyResponse(
        omega, response(start) * np.array([1.01, 1 + 0.02j]), output=model.output_names[0]
    )
    fit = gb.fit(
        gb.Problem(model, data, fixed=others, free=(name,), **options),
        starts=[{name: start}],
        progress=False,
        profiles=False,
    )
    value, step = fit.estimate[name], 1e-5
    slope = np.log(response(value + step) / response(value - step)) / (2 * step)
    error = fit.standard_error[name]
    assert error > 0
    band = fit.response_band(omega)
    assert_allclose(
        band.relative_error, np.abs([slope.real, slope.imag]) * error, rtol=1e-3, atol=1e-9
    )


def test_the_band_survives_saving_and_needs_a_covariance(likely, tmp_path):
    gb.save(likely, tmp_path / "fit.h5")
    again = gb.load(tmp_path / "fit.h5", models=[DelayedLag])
    assert_allclose(again.response_band(GRID).covariance, likely.response_band(GRID).covariance)
    exact = gb.fit(gb.Problem(Gain(), gb.FrequencyResponse([1.0], [2.0])), **ONE)
    with pytest.raises(ValueError, match="has no covariance: its warnings say why"):
        replace(exact, directions=None).response_band()
    with pytest.raises(ValueError, match="level 95 must lie"):
        likely.response_band(level=95)


def test_residuals_are_measured_less_fitted(likely):
    (residual,) = likely.residuals
    assert_allclose(residual, likely.responses[0].data.response - likely.responses[0].response)
    record = gb.Record(
        np.arange(5.0), {"x": np.arange(5.0), "y": np.array([1, 3, np.nan, 7, 9.5])}, has_time=False
    )

    class Line(gb.StateSpace):
        inputs, outputs = ("x",), ("y",)
        a = gb.Parameter(1.0)

        def output(self, x, u, p):
            return (1 + p.a * u.x,)

    fit = gb.fit(gb.Problem(Line(), record), **ONE)
    (rows,) = fit.residuals
    assert rows.shape == (1, 5)
    assert_allclose(rows[0], record["y"] - 1 - fit.estimate["a"] * record["x"])


def test_a_band_of_a_biased_response_is_about_the_response_less_its_bias():
    response = gb.FrequencyResponse([1.0, 3.0], [2.0 + 1j, -0.5j])
    bias = np.array([0.2 - 0.1j, 0.1j])
    relative = np.array([[0.05, 0.2], [0.03, 0.4]])
    covariance = np.array([[[0.04, 0.01], [0.01, 0.09]], [[0.25, -0.1], [-0.1, 0.16]]])
    band = ResponseBand(response, 0.8, 7.0, covariance, relative, bias)
    center = np.array([1.8 + 1.1j, -0.6j])
    half = t.ppf(0.9, 7) * relative
    assert_allclose(band.half_width, half)
    assert_allclose(band.magnitude, np.abs(center) * np.exp([-half[0], half[0]]))
    assert_allclose(
        band.offset,
        [np.log(np.abs(center / response.response)), np.angle(center / response.response)],
    )
    away = band.ellipses() - center[:, None]
    assert away.shape == (2, 48)
    for one, matrix in zip(away, covariance, strict=True):
        z = np.array([one.real, one.imag])
        assert_allclose(np.einsum("in,ij,jn->n", z, np.linalg.inv(matrix), z), 2 * f.ppf(0.8, 2, 7))
    assert (len(band), band.omega.tolist()) == (2, [1.0, 3.0])


def test_errors_of_a_response_are_those_of_its_derivatives():
    """Two parameters of the model are one of the fit: their derivatives add; another is not seen by the data."""
    response = gb.FrequencyResponse([1.0, 3.0], [2.0 + 1j, -0.5j])
    slope = np.array([[1 + 2j, 0.5, 0.0], [0.3j, -1.0, 2.0]])
    covariance = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.0]])
    known = KnownDirections(
        covariance, np.array([[0.0], [0.0], [1.0]]), np.ones(3), np.array([1.0, 2.0, 3.0])
    )
    bias = np.array([0.1, -0.2, 0.0])
    band = band_of(response, slope, known.of([1, 1, 2]), 0.95, 9.0, bias)
    total = slope[0, 0] + slope[0, 1]
    assert_allclose(
        band.covariance[0], 0.09 * np.outer([total.real, total.imag], [total.real, total.imag])
    )
    assert np.isnan(band.covariance[1]).all()
    ratio = total / (2 + 1j)
    assert_allclose(band.relative_error[:, 0], 0.3 * np.abs([ratio.real, ratio.imag]))
    assert_allclose(band.bias, slope @ bias)
    first = band_of(response, slope, known.of([0, 1, 1]), 0.95, 9.0, bias)
    gradient = np.array([[0.0, 2 - 1], [0.3, 0.0]])
    assert_allclose(first.covariance[1], gradient @ covariance[:2, :2] @ gradient.T)


def test_quantiles_without_degrees_of_freedom_and_of_the_normal_distribution():
    assert np.isnan(t_quantile(0.95, 0.0))
    assert t_quantile(0.95, 0.5) == pytest.approx(t.ppf(0.975, 0.5))
    assert t_quantile(0.8, np.inf) == pytest.approx(t.ppf(0.9, 1e12))
    for level in (0.0, 1.0):
        with pytest.raises(
            ValueError, match=rf"^level {level} must lie between 0 and 1, e\.g\. 0\.95\.$"
        ):
            t_quantile(level, 3.0)
