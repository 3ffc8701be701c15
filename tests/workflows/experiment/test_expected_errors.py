"""Errors expected of a test, held against the Fisher information in closed form."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.workflows.experiment.expected_errors import ExpectedErrors, expected_errors

OMEGA = np.geomspace(0.5, 8, 7)


class Lag(gb.TransferFunction):
    """K / (T s + 1), of which c does nothing."""

    K = gb.Parameter(2.0, bounds=(0.1, 10))
    T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s")
    c = gb.Parameter(1.0, bounds=(0, 2))

    def response(self, s, p):
        return p.K / (p.T * s + 1) + 0 * p.c


def problem(**options):
    true = 3 / (0.5j * OMEGA + 1)
    data = gb.FrequencyResponse(OMEGA, true, variance=(0.1 * np.abs(true)) ** 2, name="planned")
    return gb.Problem(Lag(), data, gb.MaximumLikelihood(), **options)


def test_errors_are_those_of_the_fisher_information():
    found = expected_errors(problem(fixed={"c": 1.0}), {"K": 3.0})
    s = 1j * OMEGA
    slope = np.array([1 / (0.5 * s + 1), -3 * s / (0.5 * s + 1) ** 2])
    information = 2 * np.real(slope.conj() / (0.1 * np.abs(3 / (0.5 * s + 1))) ** 2 @ slope.T)
    covariance = np.linalg.inv(information)
    assert found.values == {"K": 3.0, "T": 0.5}  # the one that was left out has its declared start
    assert_allclose(found.information, information, rtol=1e-6)
    errors = np.sqrt(np.diag(covariance))
    assert_allclose([*found.standard_error.values()], errors, rtol=1e-6)
    assert found.units == {"K": "1", "T": "s"}
    assert found.undetermined == ()
    lines = str(found).splitlines()
    assert lines[0] == "Standard errors that this test would give"
    assert [line.split() for line in lines[-2:]] == [
        ["K", "3", "±", f"{errors[0]:.2g}", "1", f"{100 * errors[0] / 3:.2g}", "%"],
        ["T", "0.5", "±", f"{errors[1]:.2g}", "s", f"{200 * errors[1]:.2g}", "%"],
    ]


def test_a_parameter_that_the_test_does_not_show_has_no_error():
    found = expected_errors(problem(), {"K": 3.0, "c": 0.5})
    assert np.isnan(found.standard_error["c"])
    assert np.isfinite(found.standard_error["K"])
    assert_allclose(found.information[2], 0.0, atol=1e-9 * found.information[0, 0])
    with pytest.raises(ValueError, match="planned has no parameter 'tau'; it has K, T, c"):
        expected_errors(problem(), {"tau": 1.0})


def test_what_is_hardly_told_apart_is_said():
    errors = {"a": 0.1234, "b": np.nan, "c": 0.5}
    made = ExpectedErrors(
        {"a": -2.0, "b": 1.0, "c": 0.0},
        errors,
        np.eye(3),
        ("b", "c"),
        dict.fromkeys("abc", "s"),
    )
    lines = [line.split() for line in str(made).splitlines()]
    assert ["a", "-2", "±", "0.12", "s", "6.2", "%"] in lines
    assert ["c", "0", "±", "0.5", "s"] in lines
    assert str(made).endswith("\n\nThe test would hardly separate b, c.")


def test_the_information_of_tests_adds_up():
    once = expected_errors(problem(fixed={"c": 1.0}), {"K": 3.0})
    both = expected_errors(sum([problem(fixed={"c": 1.0})], problem(fixed={"c": 1.0})), {"K": 3.0})
    assert_allclose(both.information, 2 * once.information, rtol=1e-6)
