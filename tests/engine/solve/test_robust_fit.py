"""Output error with bounded errors: Huber's estimate by another method, and spikes in a flight."""

import numpy as np
import pytest
from calibration_rows import Line
from hardening_spring import Spring, driven
from recipes import SoftErrors
from scipy.optimize import least_squares

import greybox as gb
from greybox.statistics.huber import HuberErrors

ROBUST = gb.OutputError(errors="huber")


def fitted(model, record, criterion):
    return gb.fit(gb.Problem(model, record, criterion), starts=[{}], progress=False)


def test_a_line_has_the_estimate_and_the_errors_of_hubers_m_estimator():
    """By reweighted least squares; errors by equation (7.41) of Huber and Ronchetti."""
    random = np.random.default_rng(5)
    x, n = np.linspace(0, 4, 80), 80
    y = 2 + 3 * x + 0.3 * random.standard_t(2, n)
    X, beta = np.column_stack([np.ones(n), x]), np.zeros(2)
    for _ in range(200):
        residual = y - X @ beta
        scale = 1.4826 * np.median(np.abs(residual))
        weight = np.minimum(1, 1.345 * scale / np.abs(residual))
        beta = np.linalg.solve(X.T @ (weight[:, None] * X), X.T @ (weight * y))
    score = np.clip(residual, -1.345 * scale, 1.345 * scale)
    slope = np.mean(np.abs(residual) <= 1.345 * scale)
    variance = np.sum(score**2) / (n - 2) / slope**2
    errors = np.sqrt(variance * np.diag(np.linalg.inv(X.T @ X)))

    fit = fitted(Line(), gb.Record(None, {"x": x, "y": y}), ROBUST)
    assert list(fit.estimate.values()) == pytest.approx(beta, rel=1e-4)
    assert list(fit.standard_error.values()) == pytest.approx(errors, rel=1e-3)


def test_spikes_are_named_and_bounding_them_restores_the_errors():
    clean = driven(8.0, noise=0.05, seed=1)
    spikes = np.where(np.arange(len(clean)) % 67 == 40, 2.0, 0.0)
    record = clean.with_signals(position=clean["position"] + spikes)
    without, plain, robust = (
        fitted(Spring(), data, criterion)
        for data, criterion in (
            (clean, gb.OutputError()),
            (record, gb.OutputError()),
            (record, ROBUST),
        )
    )
    named = [text for text in plain.warnings if "outliers" in text]
    assert "outliers are among the samples of position" in named[0]
    assert f"({np.count_nonzero(spikes)})" in named[0]
    assert f"{clean.time[40]:.4g}" in named[0]
    assert not any("outlier" in text for text in (*without.warnings, *robust.warnings))
    for name in without.free:
        error = without.standard_error[name]
        assert plain.standard_error[name] > 3 * error
        assert robust.standard_error[name] == pytest.approx(error, rel=0.2)
        assert abs(robust.estimate[name] - without.estimate[name]) < error
    # What compiles the problem again uses the same bounded errors.
    name = plain.free[0]
    interval = gb.profile(robust, name)[name].interval
    assert np.ptp(interval) == pytest.approx(np.ptp(robust.interval()[name]), rel=0.1)


def test_a_distribution_of_ones_own_has_the_estimate_of_scipy_and_the_errors_of_an_m_estimator():
    random = np.random.default_rng(7)
    x, n = np.linspace(0, 4, 80), 80
    y = 2 + 3 * x + 0.3 * random.standard_t(2, n)
    X, beta = np.column_stack([np.ones(n), x]), np.zeros(2)
    for _ in range(50):
        scale = 1.4826 * np.median(np.abs(y - X @ beta))
        beta = least_squares(
            lambda b: y - X @ b, beta, loss="soft_l1", f_scale=1.5 * scale, xtol=1e-12
        ).x
    residual = (y - X @ beta) / scale
    score = scale * residual / np.sqrt(1 + (residual / 1.5) ** 2)
    slope = np.mean((1 + (residual / 1.5) ** 2) ** -1.5)
    variance = np.sum(score**2) / (n - 2) / slope**2
    errors = np.sqrt(variance * np.diag(np.linalg.inv(X.T @ X)))

    fit = fitted(Line(), gb.Record(None, {"x": x, "y": y}), gb.OutputError(errors=SoftErrors()))
    assert list(fit.estimate.values()) == pytest.approx(beta, rel=1e-4)
    assert list(fit.standard_error.values()) == pytest.approx(errors, rel=1e-3)
    assert "large errors softly bounded" in gb.OutputError(errors=SoftErrors()).description
    # A smaller fit with normal errors is no special case of it.
    held = gb.Problem(Line(), gb.Record(None, {"x": x, "y": y}), fixed={"a": 2.0})
    smaller = gb.fit(held, starts=[{}], progress=False)
    with pytest.raises(ValueError, match="differ in their criteria"):
        gb.validation.nested_test(smaller, fit)
    # What a fit does not store is refused where it would be needed.
    with pytest.raises(ValueError, match="has errors of your own, which it does not store"):
        gb.profile(fit, "b")


def test_an_included_distribution_is_equal_to_its_name():
    assert gb.OutputError(errors=HuberErrors()) == ROBUST
    assert gb.OutputError(errors=HuberErrors(2.0)) != ROBUST
    assert ROBUST.settings["errors"] == "huber"


def test_an_unknown_kind_of_errors_is_refused():
    with pytest.raises(ValueError, match="'huber'"):
        gb.OutputError(errors="cauchy")
