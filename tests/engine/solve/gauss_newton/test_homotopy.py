"""The stages in which continuity is tightened."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from greybox.engine.solve.gauss_newton.iterate import EXACT, Progress, relaxed

# Of a merit of one: more than a tenth of it is still worth a stage.
PARAMETERS_TOO = Progress((1.0, 0.1, 0.01, 0.001, 0.0))


def after(progress, ratio, *, length=1.0, promised=0.5, distance=0.0):
    """The progress after a step that gained `ratio` times what it promised."""
    step = SimpleNamespace(decrease=promised, distance=distance)
    return progress.after(step, 1.0, ratio * promised, length)


def test_the_nodes_move_alone_until_a_step_is_as_predicted_or_their_iterations_are_over():
    progress = relaxed()
    assert progress.state_iterations == 3
    progress = after(progress, 0.5)
    assert (progress.state_iterations, progress.stages[0]) == (2, 1.0)
    predicted = after(progress, 0.95)
    assert (predicted.state_iterations, predicted.stages[0]) == (0, 1.0)
    progress = after(after(progress, 0.5), 0.5)
    assert (progress.state_iterations, progress.stages) == (0, PARAMETERS_TOO.stages)


@pytest.mark.parametrize(
    ("ratio", "length", "promised", "begins_next"),
    [
        (0.91, 1.0, 0.5, True),
        (1.09, 1.0, 0.5, True),
        (0.89, 1.0, 0.5, False),
        (1.11, 1.0, 0.5, False),
        (1.0, 0.999, 0.5, False),  # a shortened step predicts nothing
        (0.5, 1.0, 0.09, True),  # little is promised
        (0.5, 1.0, 0.11, False),
        (0.0, 0.0, 0.5, True),  # no step was found
    ],
)
def test_a_stage_ends_when_a_full_step_was_predicted_or_little_is_promised(
    ratio, length, promised, begins_next
):
    progress = after(PARAMETERS_TOO, ratio, length=length, promised=promised)
    assert progress.stages[0] == (0.1 if begins_next else 1.0)


def test_variances_shrink_until_continuity_is_exact():
    progress = replace(PARAMETERS_TOO, gap_variance=[np.array([4.0])])
    progress = after(progress, 1.0)
    assert progress.continuity_variance[0] == pytest.approx(0.04)
    for _ in range(3):
        assert not progress.is_exact
        progress = after(progress, 1.0)
    assert progress.is_exact


def test_how_an_iteration_begins():
    assert EXACT.is_exact
