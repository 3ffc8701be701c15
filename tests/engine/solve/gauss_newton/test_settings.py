"""The limits of a run of the record solver, by the names that IPOPT gives them."""

import pytest

from greybox.engine.solve.gauss_newton.settings import Settings, settings


def test_options_of_ipopt_are_settings_here():
    assert settings({}) == Settings()
    assert settings({"max_iter": 7}) == Settings(max_iter=7)
    assert settings({"max_iter": 1, "tol": 1e-300}) == Settings(1, 1e-300)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"max_iter": 5, "mu_init": 0.1}, "'mu_init' is not an option .* by IPOPT"),
        ({"max_iter": 0}, "'max_iter' is 0: give a whole number"),
        ({"max_iter": 5.0}, "'max_iter' is 5.0"),
        ({"max_iter": 2.5}, "'max_iter' is 2.5: give a whole number of iterations"),
        ({"tol": -1e-9}, "'tol' is -1e-09: give a number above 0"),
        ({"tol": 0.0}, "'tol' is 0.0: give a number above 0"),
        ({"tol": "1e-3"}, "'tol' is '1e-3'"),
        ({"tol": float("nan")}, "'tol' is nan"),
    ],
)
def test_other_options_are_refused_with_the_cure(options, words):
    with pytest.raises(ValueError, match=words):
        settings(options)
