"""Which tests to fly, against trying all numbers of repeats, and against fits of what was chosen."""

import itertools

import numpy as np
import pytest
from declared_models import TWO_LAGS, LagLagDelay

import greybox as gb
from greybox.experiment import choose_tests, expected_errors
from greybox.experiment.chosen_tests import without_surplus
from greybox.experiment.optimal_design import size_of_errors


def response(low, high, noise=0.02, rename=None, points=8):
    omega = np.geomspace(low, high, points)
    exact = gb.frequency_response(LagLagDelay(), TWO_LAGS, omega).response
    data = gb.FrequencyResponse(
        omega, exact, input="u", output="y", variance=(noise * np.abs(exact)) ** 2
    )
    return gb.Problem(LagLagDelay(), data, gb.MaximumLikelihood(), rename=rename or {})


TESTS = {
    "slow": (response(0.1, 2), 60.0),
    "middle": (response(0.5, 8), 30.0),
    "fast": (response(3, 30), 20.0),
}


def errors_of(repeats):
    parts = (
        problem
        for count, (problem, _) in zip(repeats, TESTS.values(), strict=True)
        for _ in range(count)
    )
    return expected_errors(sum(parts), TWO_LAGS)


def test_the_wanted_errors_are_reached_and_nothing_shorter_does():
    wanted = {"T1": 0.012, "tau": 0.0012}
    found = choose_tests(TESTS, TWO_LAGS, wanted=wanted)
    assert all(found.standard_error[name] <= error * (1 + 1e-6) for name, error in wanted.items())
    together = errors_of(found.repeats.values())
    for name, error in found.standard_error.items():
        assert error == pytest.approx(together.standard_error[name], rel=1e-4)
    once = [expected_errors(problem, TWO_LAGS).information for problem, _ in TESTS.values()]
    at = [list(TWO_LAGS).index(name) for name in wanted]
    shortest = np.inf
    for tried in itertools.product(range(8), repeat=3):
        information = np.tensordot(tried, once, 1)
        if any(tried) and np.linalg.cond(information) < 1e14:
            errors = np.sqrt(np.diag(np.linalg.inv(information)))[at]
            if (errors <= list(wanted.values())).all():
                shortest = min(shortest, tried @ np.array([60, 30, 20]))
    assert (
        shortest <= found.flight_time <= shortest + 60
    )  # whole tests: at most one more than needed


@pytest.mark.parametrize("optimal", ["A", "D"])
def test_no_other_repeats_in_that_time_are_much_better(optimal):
    found = choose_tests(TESTS, TWO_LAGS, seconds=300, optimal=optimal)
    assert found.flight_time <= 300
    scale = np.array(list(TWO_LAGS.values()))
    once = np.array(
        [expected_errors(problem, TWO_LAGS).information for problem, _ in TESTS.values()]
    )
    once = once * np.outer(scale, scale)
    size = {
        tried: size_of_errors(np.tensordot(tried, once, 1), optimal)
        for tried in itertools.product(range(6), range(11), range(16))
        if any(tried) and tried @ np.array([60, 30, 20]) <= 300
    }
    mine, best = size[tuple(found.repeats.values())], min(size.values())
    assert (
        mine / best if optimal == "A" else np.exp((mine - best) / 4)
    ) < 1.03  # in the variance of a parameter


def test_axes_share_what_they_have_in_common():
    own = {name: f"{name}_roll" for name in ("K", "T1", "T2")}
    axes = {"pitch": (response(0.1, 30), 40.0), "roll": (response(0.1, 30, 0.05, own), 40.0)}
    values = {**TWO_LAGS, **{own[name]: TWO_LAGS[name] for name in own}}
    found = choose_tests(axes, values, wanted={"tau": 0.002})
    assert found.repeats["roll"] <= found.repeats["pitch"]
    both = choose_tests(axes, values, seconds=160, optimal="D")
    assert all(np.isfinite(list(both.standard_error.values())))
    assert set(both.repeats.values()) == {2}  # what each tells is its own, but for the delay


def test_single_sines_are_tests_too():
    """Each gives two numbers, which four parameters are not fitted to; three of them determine all."""
    sines = {f"{omega:g}": (response(omega, omega, points=1), 10.0) for omega in (0.5, 3.0, 12.0)}
    found = choose_tests(sines, TWO_LAGS, seconds=30, optimal="D")
    assert set(found.repeats.values()) == {1}
    together = expected_errors(sum(problem for problem, _ in sines.values()), TWO_LAGS)
    assert found.standard_error == pytest.approx(together.standard_error, rel=1e-6)
    with pytest.raises(ValueError, match=r"no test separates .*: fix one of them, or add a test"):
        choose_tests({"3": sines["3"]}, TWO_LAGS, seconds=30)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({}, "either wanted standard errors or the seconds"),
        ({"wanted": {"Q": 1.0}}, "no free parameter 'Q'"),
        (
            {"values": {"T_1": 1.0}, "seconds": 100},
            "no parameter 'T_1'; it has K",
        ),
        ({"seconds": 10}, "too short"),
        ({"seconds": 100, "optimal": "E"}, "must be 'A' or 'D'"),
    ],
)
def test_bad_requests_are_named(change, sentence):
    with pytest.raises(ValueError, match=sentence):
        choose_tests(TESTS, **{"values": TWO_LAGS, **change})


def test_of_tests_that_tell_the_same_the_longest_are_left_out():
    once, durations = np.ones((3, 1, 1)), np.array([30.0, 60.0, 20.0])
    fewer = without_surplus(
        np.array([1, 2, 3]), once, durations, np.full(1, 0.5)
    )  # an error of a half: four tests
    assert [*fewer] == [1, 0, 3]


def test_there_are_tests_and_each_takes_its_time():
    with pytest.raises(ValueError, match=r"^there are no tests\.$"):
        choose_tests({}, TWO_LAGS, seconds=100)
    for seconds in (0.0, -3.0):
        wrong = {**TESTS, "fast": (TESTS["fast"][0], seconds)}
        with pytest.raises(ValueError, match=r"^the test 'fast' has no duration"):
            choose_tests(wrong, TWO_LAGS, seconds=100)


def test_tests_for_a_short_time_say_what_is_missing():
    """The slow test alone fits into 60 s; two of the fast ones, which say little of the slow lag, into 40."""
    fast = {"fast": (response(3, 30), 20.0)}
    found = choose_tests(fast, TWO_LAGS, seconds=40.0)
    assert (found.repeats, found.flight_time) == ({"fast": 2}, 40.0)
    assert found.wanted == {}
    with pytest.raises(ValueError, match="seconds=39 is too short"):
        choose_tests({"slow": TESTS["slow"]}, TWO_LAGS, seconds=39.0)
    # Of all parameters the errors count, each relative to its value: the mean of two tests of equal
    # information.
    once, twice = (
        choose_tests(fast, TWO_LAGS, seconds=seconds).standard_error for seconds in (20.0, 40.0)
    )
    assert twice == pytest.approx({name: error / np.sqrt(2) for name, error in once.items()})


@pytest.mark.parametrize(("share", "repeats"), [(6.5, 7), (7.0, 7), (7.2, 8)])
def test_errors_shrink_by_the_root_of_the_repeats(share, repeats):
    once = expected_errors(TESTS["fast"][0], TWO_LAGS).standard_error
    found = choose_tests(
        {"fast": TESTS["fast"]}, TWO_LAGS, wanted={"T2": once["T2"] / np.sqrt(share)}
    )
    assert (found.repeats, found.flight_time) == ({"fast": repeats}, 20 * repeats)
    assert found.standard_error["K"] == pytest.approx(once["K"] / np.sqrt(repeats))


def test_tests_that_fit_and_leave_parameters_open_are_too_short():
    sines = {f"{omega:g}": (response(omega, omega, points=1), 10.0) for omega in (0.5, 3.0, 12.0)}
    with pytest.raises(ValueError, match="seconds=15 is too short"):
        choose_tests(sines, TWO_LAGS, seconds=15.0)
