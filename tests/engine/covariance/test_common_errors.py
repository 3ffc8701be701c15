"""Errors that the points of a response have in common: standard errors by linear algebra, and fits to shifted data."""

from functools import cache

import numpy as np
import pytest
from evaluation import numeric_jacobian
from numpy.testing import assert_allclose

import greybox as gb
from greybox.models.rotor import Rotor

TRUTH = {"K_Omega": 1000.0, "T_rotor": 0.05, "T_delay": 0.004}
OMEGA = np.geomspace(1, 30, 12)


def model(values):
    return gb.frequency_response(Rotor(), dict(zip(TRUTH, values, strict=True)), OMEGA).response


EXACT = model(TRUTH.values())
COMMON = (
    np.array([np.full(12, 0.02), 0.0005j * OMEGA]) * EXACT
)  # of the gain, and a delay of 0.5 ms
OWN = (0.01 * np.abs(EXACT)) ** 2 * np.linspace(0.5, 2, 12)
VARIANCE = OWN + np.sum(np.abs(COMMON) ** 2, axis=0)
NOISE = 0.01 * np.abs(EXACT) * np.exp(2j * np.pi * np.random.default_rng(4).random(12))


@cache
def fitted(criterion, shift=-1, size=0.0, common=True, noise=0.0, known=True):
    measured = EXACT + noise * NOISE + (size * COMMON[shift] if size else 0)
    words = {"variance": VARIANCE} if known else {}
    words |= {"common_errors": COMMON} if common else {}
    data = gb.FrequencyResponse(OMEGA, measured, "u", "Omega", **words)
    return gb.fit(gb.Problem(Rotor(), data, criterion), starts=[TRUTH], progress=False)


def errors(fit):
    return np.array([fit.standard_error[name] for name in TRUTH])


def stacked(values):
    return np.concatenate([values.real, values.imag])


def test_standard_errors_are_those_of_the_whole_covariance_matrix_of_the_points():
    J = numeric_jacobian(lambda x: stacked(model(x)), list(TRUTH.values()))
    weight = np.tile(1 / VARIANCE, 2)
    points = np.diag(np.tile(OWN / 2, 2)) + sum(np.outer(stacked(c), stacked(c)) for c in COMMON)
    A = np.linalg.solve(J.T @ (weight[:, None] * J), J.T * weight)
    assert_allclose(
        errors(fitted(gb.MaximumLikelihood())), np.sqrt(np.diag(A @ points @ A.T)), rtol=1e-4
    )


@pytest.mark.parametrize("known", [True, False], ids=["given variances", "size from the residuals"])
def test_they_are_larger_by_how_far_the_common_errors_move_the_estimate(known):
    """The delay has the second error whole, the gain the first; the lag has neither."""
    criterion = gb.MaximumLikelihood() if known else gb.SquaredRelativeError()
    noise = 0.0 if known else 1.0
    moved = []
    for row in (0, 1):
        ends = [fitted(criterion, row, sign * 0.1, noise=noise, known=known) for sign in (1, -1)]
        moved.append([(ends[0].estimate[name] - ends[1].estimate[name]) / 0.2 for name in TRUTH])
    moved = np.sqrt(np.sum(np.square(moved), axis=0))
    assert_allclose(moved, [20.0, 0.0, 0.0005], rtol=0.02, atol=2e-5)
    with_, without = (
        errors(fitted(criterion, common=c, noise=noise, known=known)) for c in (True, False)
    )
    own = np.sqrt(np.mean(OWN / VARIANCE)) if known else 1.0  # a given variance contains both
    assert_allclose(with_**2, moved**2 + (own * without) ** 2, rtol=0.15 if known else 0.01)
    fit = fitted(criterion, noise=noise, known=known)
    assert "common errors" in fit.parts[0].condition
    systematic = [q.systematic for q in fit.quantities[: len(TRUTH)]]
    assert_allclose(systematic, moved, rtol=0.02, atol=2e-5)
    assert "± error  systematic" in str(fit)
    assert "systematic" not in str(fitted(criterion, common=False, noise=noise, known=known))


def test_replicates_have_them_too():
    """Of normal errors drawn anew, the estimates scatter by the standard errors, to the 7 % that 200 of them tell."""
    fit = fitted(gb.MaximumLikelihood(), noise=0.5)
    drawn = gb.bootstrap(fit, 200, progress=False)
    assert_allclose([drawn.standard_error[name] for name in TRUTH], errors(fit), rtol=0.2)


def test_a_saved_fit_has_them(tmp_path):
    fit = fitted(gb.MaximumLikelihood())
    gb.save(fit, tmp_path / "fit.h5")
    again = gb.load(tmp_path / "fit.h5")
    assert_allclose(again.responses[0].data.common_errors, COMMON)
    assert str(again) == str(fit)
