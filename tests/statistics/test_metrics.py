"""Measures of fit against their formulas."""

import math

import numpy as np
import pytest

from greybox.statistics.metrics import fit_percent, rms

Y = np.array([1.0, 2.0, np.nan, 4.0, 7.0])
P = np.array([1.5, 1.0, 3.0, np.nan, 6.0])
KNOWN = [0, 1, 4]


def test_measures_of_fit_are_their_formulas_on_what_both_have():
    y = Y[KNOWN]
    p = P[KNOWN]
    assert rms(Y - P) == pytest.approx(np.sqrt(np.mean((y - p) ** 2)))
    fit = 100 * (1 - np.linalg.norm(y - p) / np.linalg.norm(y - y.mean()))
    assert fit_percent(Y, P) == pytest.approx(fit)
    assert fit_percent(1e-3 * Y, 1e-3 * P) == pytest.approx(fit)  # in any unit


def test_measures_of_nothing_are_not_known():
    nothing = np.full(3, np.nan)
    assert math.isnan(fit_percent(nothing, nothing))
    assert math.isnan(fit_percent(np.ones(3), np.zeros(3)))  # a constant never varies
    assert math.isnan(rms(nothing))
    with pytest.raises(ValueError, match="3 measured and 2 predicted values"):
        fit_percent(np.ones(3), np.ones(2))
