"""The settings of the record solver are those that the kept ablation measured, and options change them by name."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from greybox.compiled.strategies import Strategies, constants, switches, with_options

KEPT = Path(__file__).parents[2] / "benchmarks" / "results" / "ablation.txt"
LATER = {"short_record", "continued_samples"}  # than that output


def test_all_strategies_are_on():
    assert all(getattr(Strategies(), name) is True for name in switches())
    assert set(switches()) | set(constants()) == vars(Strategies()).keys()
    assert not set(switches()) & set(constants())


def test_constants_are_those_around_which_the_ablation_varied_them():
    """A tenth and ten times each; where that makes no sense, two other values on either side."""
    tried = {}
    for name, value in re.findall(r"^(\w+) = (\S+) ", KEPT.read_text(), re.MULTILINE):
        tried.setdefault(name, set()).add(float(value))
    for name in set(constants()) - LATER:
        value, low, high = getattr(Strategies(), name), min(tried[name]), max(tried[name])
        assert low < value < high, name
        if high / low == pytest.approx(100):
            assert value == pytest.approx(10 * low), name


def test_options_of_ipopt_are_settings_here():
    settings = Strategies(short_step=0.07)
    assert with_options(settings, {}) == settings
    assert with_options(settings, {"max_iter": 7}) == replace(settings, max_iterations=7)
    assert with_options(settings, {"tol": 3}) == replace(settings, tolerance=3)
    assert with_options(settings, {"max_iter": 1, "tol": 1e-300}) == replace(
        settings, max_iterations=1, tolerance=1e-300
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"max_iter": 5, "mu_init": 0.1},
            "solver_options 'mu_init' is not known to the Gauss-Newton solver: give max_iter or tol, or solve by "
            "IPOPT, method=MultipleShooting(ipopt=True).",
        ),
        ({"max_iter": 0}, "solver_options 'max_iter' is 0: give a whole number of iterations."),
        ({"max_iter": 5.0}, "solver_options 'max_iter' is 5.0: give a whole number of iterations."),
        ({"tol": 0.0}, "solver_options 'tol' is 0.0: give a number above 0."),
        ({"tol": "1e-3"}, "solver_options 'tol' is '1e-3': give a number above 0."),
        ({"tol": float("nan")}, "solver_options 'tol' is nan: give a number above 0."),
    ],
)
def test_other_options_are_refused_with_the_cure(options, words):
    with pytest.raises(ValueError, match=f"^{re.escape(words)}$"):
        with_options(Strategies(), options)
