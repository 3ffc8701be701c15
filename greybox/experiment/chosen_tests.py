"""Which of several tests to fly, and how often: axes, operating points, kinds of excitation."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import get_args

import numpy as np

from greybox.experiment.expected_errors import expected_errors
from greybox.experiment.optimal_design import (
    Optimality,
    optimal_shares,
    require_determined,
    shares,
    size_of_errors,
    time_needed,
    variances,
)
from greybox.files.arrays import Array, IntArray
from greybox.files.text_table import text_table
from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum


@dataclass(frozen=True, eq=False)
class ChosenTests:
    """How often each test shall be flown; prints itself.

    Attributes
    ----------
    repeats : mapping of name to int
        Of every test, zero for those that are not worth their time.
    seconds : mapping of name to float
        That each test takes once.
    standard_error : mapping of name to float
        Expected of one fit to all of them; NaN where they do not determine a parameter.
    wanted : mapping of name to float
    units : mapping of name to str
    flight_time : float, s
    equally_often : float, s
        The flight time for the wanted errors, or infinite time for none, if all tests were flown
        equally often.
    """

    repeats: Mapping[str, int]
    seconds: Mapping[str, float]
    standard_error: Mapping[str, float]
    wanted: Mapping[str, float]
    units: Mapping[str, str]
    flight_time: float
    equally_often: float

    def __str__(self) -> str:
        tests = [
            (name, str(count), f"{count * self.seconds[name]:.0f}")
            for name, count in self.repeats.items()
        ]
        errors = [
            (
                name,
                f"± {error:.2g}",
                f"± {self.wanted[name]:.2g}" if name in self.wanted else "",
                self.units[name],
            )
            for name, error in self.standard_error.items()
        ]
        lines = [f"{sum(self.repeats.values())} tests, {self.flight_time:.0f} s of flight"]
        if self.wanted:
            lines.append(
                f"all tests equally often would take {self.equally_often / self.flight_time:.2g} times as long"
            )
        lines += ["", text_table(("test", "flown", "s"), tests)]
        return "\n".join([*lines, "", text_table(("", "expected", "wanted", "unit"), errors)])


def choose_tests(
    tests: Mapping[str, tuple[Problem | Sum, float]],
    values: Mapping[str, float],
    *,
    wanted: Mapping[str, float] | None = None,
    seconds: float = math.inf,
    optimal: Optimality = "A",
) -> ChosenTests:
    """Choose which tests to fly and how often: for wanted errors in the shortest time, or for the best in a given time.

    The Fisher information of the tests adds, parameters of the same name being one; that of each is
    `expected_errors`'. The shares of the time are those of an optimal design (Fedorov 1972, Theory
    of Optimal Experiments), rounded to whole tests.

    Parameters
    ----------
    tests : mapping of name to (problem, seconds)
        The problem that would be fitted, with data from a virtual flight or of expected variances,
        for each axis, operating point or kind of excitation; and how long the test takes.
    values : mapping of name to float
        Rough estimates.
    wanted : mapping of name to float, optional
        Standard errors of the parameters that matter; the flight is then as short as possible.
    seconds : float
        Without `wanted`: how long the flight may be.
    optimal : "A" or "D"
        Without `wanted`: the least sum of squared errors, each relative to its value, or the
        smallest volume of the region of all parameters, which does not depend on their units.

    Raises
    ------
    ValueError
        For names that are not there, and when the tests together do not determine every parameter.
    """
    if bool(wanted) == math.isfinite(seconds):
        raise ValueError("give either wanted standard errors or the seconds of the flight.")
    if optimal not in get_args(Optimality):
        raise ValueError(f"optimal is {optimal!r:.40}: give 'A' or 'D'.")
    wrong = next((name for name, (_, each) in tests.items() if not each > 0), None)
    if not tests or wrong is not None:
        raise ValueError(
            "there are no tests."
            if wrong is None
            else f"the test {wrong!r} takes no time: give seconds."
        )
    parameters = dict.fromkeys(name for problem, _ in tests.values() for name in problem.parameters)
    unknown = next((name for name in values if name not in parameters), None)
    if unknown is not None:
        raise ValueError(
            f"{unknown} is no parameter of the tests: they have {', '.join(parameters)}."
        )
    expected = []
    for problem, _ in tests.values():
        known = {name: value for name, value in values.items() if name in problem.parameters}
        expected.append(expected_errors(problem, known))
    names = tuple(dict.fromkeys(name for one in expected for name in one.standard_error))
    missing = next((name for name in (wanted or {}) if name not in names), None)
    if missing is not None:
        raise ValueError(
            f"{missing} is not estimated in any of the tests; free are {', '.join(names)}."
        )
    at = {name: value for one in expected for name, value in one.values.items()}
    units = {name: unit for one in expected for name, unit in one.units.items()}
    unit = np.array([(wanted or {}).get(name, abs(at[name]) or 1.0) for name in names])
    once = np.array(
        [_spread(one.information, tuple(one.standard_error), names) for one in expected]
    )
    once = once * np.outer(unit, unit)
    duration = np.array([each for _, each in tests.values()])
    require_determined(once.sum(axis=0), names, "no test", "add a test")

    rates = once / duration[:, None, None]
    target = np.array([1.0 if not wanted or name in wanted else np.inf for name in names])
    if wanted:
        share = shares(rates, target)
        total = time_needed(np.tensordot(share, rates, 1), target)
        repeats = _without_surplus(
            np.ceil(share * total / duration - 1e-9).astype(int), once, duration, target
        )
    else:
        share = optimal_shares(rates, optimal)
        repeats = _filled(
            np.floor(share * seconds / duration + 1e-9).astype(int),
            once,
            duration,
            seconds,
            optimal,
        )
        if not repeats.any() or not math.isfinite(size_of_errors(_all_of(repeats, once), optimal)):
            raise ValueError(
                f"{seconds:g} s are too short for tests that determine every parameter: give more."
            )
    errors = np.sqrt(variances(_all_of(repeats, once))) * unit
    equal = time_needed(once.sum(axis=0) / duration.sum(), target)
    return ChosenTests(
        dict(zip(tests, repeats.tolist(), strict=True)),
        {name: each for name, (_, each) in tests.items()},
        dict(zip(names, errors.tolist(), strict=True)),
        dict(wanted or {}),
        units,
        float(repeats @ duration),
        float(np.ceil(equal / duration.sum() - 1e-9) * duration.sum()),
    )


def _spread(information: Array, own: tuple[str, ...], names: tuple[str, ...]) -> Array:
    """Return the information of a test in the order of all names; zero for parameters that it does not have."""
    where = [names.index(name) for name in own]
    found = np.zeros((len(names), len(names)))
    found[np.ix_(where, where)] = information
    return found


def _all_of(repeats: IntArray, once: Array) -> Array:
    """Return the information of all tests together."""
    return np.einsum("k,kij->ij", repeats, once)


def _without_surplus(repeats: IntArray, once: Array, duration: Array, target: Array) -> IntArray:
    """Return fewer repeats, the longest left out first, as long as the errors stay as wanted."""
    for k in np.argsort(-duration):
        while repeats[k]:
            fewer = repeats - (np.arange(len(repeats)) == k)
            if time_needed(_all_of(fewer, once), target) > 1 + 1e-9:
                break
            repeats = fewer
    return repeats


def _filled(
    repeats: IntArray, once: Array, duration: Array, seconds: float, optimal: Optimality
) -> IntArray:
    """Return more repeats, as long as there is time: each time the one that is worth most."""
    while True:
        more = [repeats + (np.arange(len(repeats)) == k) for k in range(len(repeats))]
        fitting = [tried for tried in more if tried @ duration <= seconds * (1 + 1e-9)]
        if not fitting:
            return repeats
        repeats = min(fitting, key=lambda tried: size_of_errors(_all_of(tried, once), optimal))
