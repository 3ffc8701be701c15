"""The line search on a function of one variable, whose iterates are numbers."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from greybox.solve import Strategies
from greybox.solve.gauss_newton.line_search import line_search


@dataclass
class Line:
    """Stands for all parts: an iterate is a number, a step another one, and gaps are closed by going to `closed`."""

    settings: Strategies = field(default_factory=Strategies)
    closed: float | None = None

    def moved(self, iterate, step, length):
        return iterate + length * step

    def close_gaps(self, trial, step, multipliers, length):
        return trial if self.closed is None else self.closed


@dataclass
class Stage:
    is_exact: bool = False
    multipliers: tuple = ()


def square(x):
    return x**2


def test_a_step_that_decreases_the_merit_is_taken_whole():
    assert line_search(Line(), 1.0, -1.5, square, 1.0, Stage()) == (-0.5, 1.0)


def test_a_step_that_is_too_long_is_shortened():
    trial, length = line_search(Line(), 1.0, -10.0, square, 1.0, Stage())
    reduction = Strategies().step_reduction
    assert length == pytest.approx(reduction**2)  # -9, -3, -0.6
    assert square(trial) < 1.0


def test_a_step_uphill_is_not_taken():
    assert line_search(Line(), 1.0, 1.0, square, 1.0, Stage()) == (None, 0.0)


def test_closing_the_gaps_may_save_a_whole_step_where_continuity_is_exact():
    assert line_search(Line(closed=0.5), 1.0, -10.0, square, 1.0, Stage(is_exact=True)) == (
        0.5,
        1.0,
    )
    off = Line(Strategies(second_order_correction=False), closed=0.5)
    assert line_search(off, 1.0, -10.0, square, 1.0, Stage(is_exact=True))[1] < 1
    assert line_search(Line(closed=0.5), 1.0, -10.0, square, 1.0, Stage(is_exact=False))[1] < 1


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e6])
@pytest.mark.parametrize(("share", "taken"), [(0.9, True), (1.1, False)])
def test_a_merit_that_grows_by_rounding_alone_is_taken(size, share, taken):
    """Of the cost, or of one where it is smaller."""
    rounding = Strategies().cost_rounding * max(size, 1.0)
    trial, length = line_search(
        Line(), 0.0, 1.0, lambda x: size + share * rounding * (x != 0), size, Stage()
    )
    assert (trial, length) == ((1.0, 1.0) if taken else (None, 0.0))


def test_no_share_of_a_step_below_the_shortest_is_tried():
    settings, tried = Strategies(), []
    found = line_search(Line(), 1.0, 1.0, lambda x: tried.append(x - 1) or 2.0, 1.0, Stage())
    assert found == (None, 0.0)
    lengths = settings.step_reduction ** np.arange(len(tried))
    np.testing.assert_allclose(tried, lengths)
    assert lengths[-1] > settings.shortest_step >= settings.step_reduction * lengths[-1]
