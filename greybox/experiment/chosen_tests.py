"""Which of several tests to fly, and how often: axes, operating points, kinds of excitation.

Begin with `choose_tests`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import get_args

import numpy as np

from greybox.experiment.expected_errors import ExpectedErrors, expected_errors, wanted_rows
from greybox.experiment.optimal_design import (
    Optimality,
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
from greybox.modeling.model import require_known


@dataclass(frozen=True, eq=False)
class ChosenTests:
    """How often to fly each test; printed, it is a table.

    Attributes
    ----------
    repeats : mapping of name to int
        Number of flights of every test; zero if it is not worth its time.
    seconds : mapping of name to float
        Duration of one flight of each test.
    standard_error : mapping of name to float
        Expected of one fit to all of them; NaN for a parameter that they do not determine.
    wanted : mapping of name to float
    units : mapping of name to str
    flight_time : float, s
    """

    repeats: Mapping[str, int]
    seconds: Mapping[str, float]
    standard_error: Mapping[str, float]
    wanted: Mapping[str, float]
    units: Mapping[str, str]
    flight_time: float

    def __str__(self) -> str:
        tests = [
            (name, str(count), f"{count * self.seconds[name]:.0f}")
            for name, count in self.repeats.items()
        ]
        errors = [
            (*row, self.units[row[0]]) for row in wanted_rows(self.standard_error, self.wanted)
        ]
        title = f"{sum(self.repeats.values())} tests, {self.flight_time:.0f} s of flight"
        lines = [title, "", text_table(("test", "flown", "s"), tests)]
        return "\n".join([*lines, "", text_table(("", "expected", "wanted", "unit"), errors)])


def choose_tests(
    tests: Mapping[str, tuple[Problem | Sum, float]],
    values: Mapping[str, float],
    *,
    wanted: Mapping[str, float] | None = None,
    seconds: float = math.inf,
    optimal: Optimality = "A",
) -> ChosenTests:
    """Choose which tests to fly, and how often.

    The flight reaches the wanted errors in the shortest time, or has the smallest errors in a given
    time.

    The Fisher information of the tests adds up, with parameters shared by name; that of each test
    is from `expected_errors`. For wanted errors the shares of the time are those of an optimal
    design (Fedorov 1972, Theory of Optimal Experiments), rounded up to whole tests; a given time is
    filled with the tests that gain most.

    Parameters
    ----------
    tests : mapping of name to (problem, seconds)
        For each axis, operating point or kind of excitation the problem that would be fitted, with
        data from a virtual flight or with expected variances, and the duration of the test.
    values : mapping of name to float
        Rough estimates.
    wanted : mapping of name to float, optional
        Standard errors of the parameters that matter; the flight is then as short as possible.
    seconds : float
        Duration of the flight, if there are no `wanted` errors.
    optimal : "A" or "D"
        In a given time: the least sum of squared errors, each relative to its value, or the
        smallest confidence region of all parameters, which does not depend on their units.

    Raises
    ------
    ValueError
        For unknown names, and if the tests together do not determine every parameter.
    """
    _require_valid(tests, values, wanted, seconds, optimal)
    expected = []
    for problem, _ in tests.values():
        own_values = {name: v for name, v in values.items() if name in problem.parameters}
        expected.append(expected_errors(problem, own_values))
    names = tuple(dict.fromkeys(name for errors in expected for name in errors.standard_error))
    require_known(wanted or {}, names, "free parameter", "the list of tests")

    # In units of the wanted errors, or else of the values, all parameters have size one.
    estimates = {name: value for errors in expected for name, value in errors.values.items()}
    sizes = np.array([(wanted or {}).get(name, abs(estimates[name]) or 1.0) for name in names])
    once = np.array([_in_order(errors, names) for errors in expected]) * np.outer(sizes, sizes)
    duration = np.array([length for _, length in tests.values()])
    require_determined(once.sum(axis=0), names, "no test", "add a test")

    if wanted:
        rates = once / duration[:, None, None]
        target = np.array([1.0 if name in wanted else np.inf for name in names])
        share = shares(rates, target)
        total = time_needed(np.tensordot(share, rates, 1), target)
        rounded_up = np.ceil(share * total / duration - 1e-9).astype(int)
        repeats = without_surplus(rounded_up, once, duration, target)
    else:
        repeats = _filled(once, duration, seconds, optimal)
        if not repeats.any() or not math.isfinite(
            size_of_errors(np.tensordot(repeats, once, 1), optimal)
        ):
            raise ValueError(
                f"seconds={seconds:g} is too short for tests that determine every parameter: give "
                "more."
            )
    errors = np.sqrt(variances(np.tensordot(repeats, once, 1))) * sizes
    return ChosenTests(
        repeats=dict(zip(tests, repeats.tolist(), strict=True)),
        seconds={name: length for name, (_, length) in tests.items()},
        standard_error=dict(zip(names, errors.tolist(), strict=True)),
        wanted=dict(wanted or {}),
        units={name: unit for test in expected for name, unit in test.units.items()},
        flight_time=float(repeats @ duration),
    )


def _require_valid(
    tests: Mapping[str, tuple[Problem | Sum, float]],
    values: Mapping[str, float],
    wanted: Mapping[str, float] | None,
    seconds: float,
    optimal: str,
) -> None:
    if bool(wanted) == math.isfinite(seconds):
        raise ValueError("give either wanted standard errors or the seconds of the flight.")
    if optimal not in get_args(Optimality):
        raise ValueError(f"optimal={optimal!r:.40} must be 'A' or 'D'.")
    if not tests:
        raise ValueError("there are no tests.")
    for name, (_, length) in tests.items():
        if not length > 0:
            raise ValueError(f"the test {name!r} has no duration: give it in seconds.")
    parameters = dict.fromkeys(name for problem, _ in tests.values() for name in problem.parameters)
    require_known(values, parameters, "parameter", "the list of tests")


def _in_order(errors: ExpectedErrors, names: tuple[str, ...]) -> Array:
    """Return the information of a test in the order of all names; zero where it has none."""
    places = [names.index(name) for name in errors.standard_error]
    information = np.zeros((len(names), len(names)))
    information[np.ix_(places, places)] = errors.information
    return information


def without_surplus(repeats: IntArray, once: Array, duration: Array, target: Array) -> IntArray:
    """Drop repeats, the longest tests first, as long as the errors stay as small as wanted."""
    # After rounding up, the others may make a flight unnecessary; dropping the longest saves most.
    for k in np.argsort(-duration):
        while repeats[k]:
            fewer: IntArray = repeats - (np.arange(len(repeats)) == k)
            if time_needed(np.tensordot(fewer, once, 1), target) > 1 + 1e-9:
                break
            repeats = fewer
    return repeats


def _filled(once: Array, duration: Array, seconds: float, optimal: Optimality) -> IntArray:
    """Return how often each test fits into the time, always adding the one that gains most.

    A gain is that of a second (Fedorov 1972, chapter 2.5).
    """
    repeats = np.zeros(len(once), dtype=int)
    # A little information on everything, because the first tests alone may not determine all
    # parameters.
    information = 1e-9 * np.diag(np.diag(once.sum(axis=0)))
    while (fits := duration <= (seconds - repeats @ duration) * (1 + 1e-9)).any():
        size = [size_of_errors(information + more, optimal) for more in once]
        gains = (size_of_errors(information, optimal) - np.array(size)) / duration
        best = np.where(fits, gains, -math.inf).argmax()
        repeats[best] += 1
        information = information + once[best]
    return repeats
