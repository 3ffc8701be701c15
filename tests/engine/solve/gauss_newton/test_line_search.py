"""The line search on a function of one variable, whose iterates are numbers."""

from dataclasses import dataclass

import numpy as np
import pytest

from greybox.engine.solve.gauss_newton.line_search import REDUCTION, SHORTEST_STEP, line_search
from greybox.engine.solve.stationarity import ROUNDING


@dataclass
class Line:
    """Stands for all parts.

    An iterate is a number, a step another one, and gaps are closed by going to `closed`.
    """

    closed: float | None = None

    def moved(self, iterate, step, length):
        return iterate + length * step

    def close_gaps(self, trial, step, length):
        return trial if self.closed is None else self.closed


class Step(float):
    """A step that is a number; exact continuity has multipliers."""

    multipliers: tuple = ()


class ExactStep(Step):
    multipliers = (1.0,)


def square(x):
    return x**2


def test_a_step_that_decreases_the_merit_is_taken_whole():
    assert line_search(Line(), 1.0, Step(-1.5), square, 1.0) == (-0.5, 1.0)


def test_a_step_that_is_too_long_is_shortened():
    trial, length = line_search(Line(), 1.0, Step(-10.0), square, 1.0)
    assert length == pytest.approx(REDUCTION**2)  # -9, -3, -0.6
    assert square(trial) < 1.0


def test_closing_the_gaps_may_save_a_whole_step_where_continuity_is_exact():
    assert line_search(Line(closed=0.5), 1.0, ExactStep(-10.0), square, 1.0) == (0.5, 1.0)
    assert line_search(Line(closed=0.5), 1.0, Step(-10.0), square, 1.0)[1] < 1


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e6])
@pytest.mark.parametrize(("share", "taken"), [(0.9, True), (1.1, False)])
def test_a_merit_that_grows_by_rounding_alone_is_taken(size, share, taken):
    """Of the cost, or of one where it is smaller."""
    rounding = ROUNDING * max(size, 1.0)
    trial, length = line_search(
        Line(), 0.0, Step(1.0), lambda x: size + share * rounding * (x != 0), size
    )
    assert (trial, length) == ((1.0, 1.0) if taken else (None, 0.0))


def test_no_share_of_a_step_uphill_down_to_the_shortest_is_taken():
    tried = []
    end = line_search(Line(), 1.0, Step(1.0), lambda x: tried.append(x - 1) or 2.0, 1.0)
    assert end == (None, 0.0)
    lengths = REDUCTION ** np.arange(len(tried))
    np.testing.assert_allclose(tried, lengths)
    assert lengths[-1] > SHORTEST_STEP >= REDUCTION * lengths[-1]
