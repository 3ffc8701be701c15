"""The settings of the record solver: the options of IPOPT set its numbers."""

from dataclasses import replace

import pytest

from greybox.compiled.strategies import Strategies, with_options


def test_options_of_ipopt_are_settings_here():
    settings = Strategies(continued_runs=False)
    assert with_options(settings, {}) == settings
    assert with_options(settings, {"max_iter": 7}) == replace(settings, max_iterations=7)
    assert with_options(settings, {"tol": 3}) == replace(settings, tolerance=3)
    assert with_options(settings, {"max_iter": 1, "tol": 1e-300}) == replace(
        settings, max_iterations=1, tolerance=1e-300
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"max_iter": 5, "mu_init": 0.1}, "'mu_init' is not an option .* by IPOPT"),
        ({"max_iter": 0}, "'max_iter' is 0: give a whole number"),
        ({"max_iter": 5.0}, "'max_iter' is 5.0"),
        ({"tol": 0.0}, "'tol' is 0.0: give a number above 0"),
        ({"tol": "1e-3"}, "'tol' is '1e-3'"),
        ({"tol": float("nan")}, "'tol' is nan"),
    ],
)
def test_other_options_are_refused_with_the_cure(options, words):
    with pytest.raises(ValueError, match=words):
        with_options(Strategies(), options)
