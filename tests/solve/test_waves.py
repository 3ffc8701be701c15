"""In which order starts are tried, and when there were enough."""

from math import comb
from types import SimpleNamespace

import numpy as np
import pytest

from greybox.solve.local_solver import Screened
from greybox.solve.minima import Minimum
from greybox.solve.multistart import AllAtOnce, FoundAgain, PromisingFirst, probability_of_no_other
from greybox.solve.runs import Run


def runs_to(*costs):
    return [
        Run(k, np.zeros(1), np.zeros(1), cost, "s", bool(np.isfinite(cost)), 1, 0.1)
        for k, cost in enumerate(costs)
    ]


def nlp(*, is_likelihood, numbers=(30, 20)):
    return SimpleNamespace(
        parts=[SimpleNamespace(is_likelihood=is_likelihood, numbers=n) for n in numbers]
    )


def test_the_promising_starts_come_first_and_the_others_in_their_order():
    waves, asked = PromisingFirst(promising=3, agreeing=2), []
    solver = SimpleNamespace(screened=lambda starts: asked.append(len(starts)) or "compared")
    assert waves.screened(solver, np.zeros((3, 2))) is None  # all of them are run anyway
    assert waves.screened(solver, np.zeros((4, 2))) == "compared"
    assert asked == [4]
    order = Screened(np.array([4, 0, 5, 2, 1, 3]), np.zeros(6), np.zeros((6, 2)))
    assert [list(wave) for wave in waves.numbers(6, order)] == [[4, 0, 5], [1, 2, 3]]
    assert [list(wave) for wave in waves.numbers(6, None)] == [[0, 1, 2, 3, 4, 5]]
    assert [list(wave) for wave in AllAtOnce().numbers(3, None)] == [[0, 1, 2]]
    assert not AllAtOnce().are_enough(None, [], [])


@pytest.mark.parametrize(("agreeing", "enough"), [(3, True), (4, False)])
def test_promising_starts_are_enough_where_so_many_end_at_the_lowest_cost(agreeing, enough):
    """Within a tenth of a unit of log-likelihood: of costs of 50 numbers, 0.1 / 50 of their size."""
    minima = [Minimum(8.0, np.zeros(1), (0,), 1)]
    waves = PromisingFirst(promising=5, agreeing=agreeing)
    likelihoods = runs_to(8.0, 8.09, 8.11, 8.05, np.inf)
    assert waves.are_enough(nlp(is_likelihood=True), likelihoods, minima) is enough
    costs = runs_to(8.0, 8.0 + 0.9 * 0.016, 8.0 + 1.1 * 0.016, 8.01, np.inf)
    assert waves.are_enough(nlp(is_likelihood=False), costs, minima) is enough


@pytest.mark.parametrize(
    ("count", "waves"),
    [
        (10, [(0, 10)]),
        (32, [(0, 32)]),
        (33, [(0, 32), (32, 33)]),
        (200, [(0, 32), (32, 64), (64, 128), (128, 200)]),
    ],
)
def test_waves_double_the_number_of_starts(count, waves):
    assert [(wave[0], wave[-1] + 1) for wave in FoundAgain(0.02).numbers(count, None)] == waves


@pytest.mark.parametrize(("searches", "minima"), [(5, 2), (30, 1), (30, 4), (100, 7)])
def test_the_probability_that_no_minimum_is_left(searches, minima):
    """Of Boender and Rinnooy Kan in factorials: (n - 1)! (n - 2)! / ((n + w - 1)! (n - w - 2)!)."""
    wanted = comb(searches - 2, minima) / comb(searches + minima - 1, minima)
    assert probability_of_no_other(searches, minima) == pytest.approx(wanted)
    assert probability_of_no_other(minima + 1, minima) == 0
    assert probability_of_no_other(minima + 2, minima) > 0


def test_starts_are_enough_when_another_minimum_is_unlikely():
    """Of one minimum the error is 2 / n; runs that failed do not count."""
    minima = [Minimum(1.0, np.zeros(1), (0,), 1)]
    for converged, error in ((39, 0.05), (41, 0.05)):
        runs = runs_to(*[1.0] * converged, *[np.inf] * 20)
        assert FoundAgain(error).are_enough(None, runs, minima) is (2 / converged <= error)
    assert not FoundAgain(0.1).are_enough(None, runs_to(*[1.0] * 41), minima * 3)
