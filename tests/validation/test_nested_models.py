"""Tests of terms that one model has more than another have their nominal size and find what is needed."""

import numpy as np
import pytest
from drag_flights import LINEAR, Drag, LinearDrag, fitted, flight

import greybox as gb


def test_a_nested_test_says_what_is_needed():
    record = flight({"a5": 0.2, "C_x": 0.05}, 8)
    small, large = fitted(LinearDrag(), record), fitted(Drag(), record)
    found = gb.validation.nested_test(small, large)
    assert found.terms == ("C_x",)
    assert found.p_value < 1e-6
    assert str(found).startswith("C_x is needed: LinearDrag is rejected by the test against Drag")
    held = gb.validation.nested_test(fitted(Drag(), record, fixed={"C_x": 0.05}), large)
    assert held.p_value > 0.01
    assert str(held).startswith("C_x is not needed: Drag with C_x fixed explains the data as well as Drag (F(1, ")
    # Of a term that changes little the scaled ratio is the squared t-value.
    record = flight({"a5": 0.2, "C_x": 0.03}, 8, noise=0.6)
    small, large = fitted(LinearDrag(), record), fitted(Drag(), record)
    t = large.estimate["C_x"] / large.standard_error["C_x"]
    assert 2 < t < 12
    assert gb.validation.nested_test(small, large).statistic == pytest.approx(t**2, rel=0.15)


def test_a_nested_test_keeps_its_size_where_residuals_are_correlated():
    scaled, bare = [], []
    for seed in range(80):
        record = flight(LINEAR, 100 + seed, duration=15.0, color=0.7)
        found = gb.validation.nested_test(fitted(LinearDrag(), record), fitted(Drag(), record))
        scaled.append(found.p_value < 0.05)
        bare.append(found.likelihood_ratio > 3.84)
    assert np.mean(bare) > 0.2  # as if the residuals were white
    assert np.mean(scaled) < 0.125  # at 5 %: 97.5 % of such experiments with up to 80 of 80
