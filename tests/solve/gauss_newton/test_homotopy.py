"""The stages in which continuity is tightened."""

from types import SimpleNamespace

import numpy as np
import pytest

from greybox.solve import Strategies
from greybox.solve.gauss_newton.homotopy import Progress

HERE = SimpleNamespace(z=np.zeros(1), nodes=[np.zeros((1, 1))])


def stepped(progress, predicted, gained, length=1.0, done=False):
    progress.advance(HERE, SimpleNamespace(decrease=predicted), gained, length, done=done)


def begun(**settings):
    progress = Progress(Strategies(**settings))
    progress.begin(HERE, [np.array([4.0])])
    return progress


def test_the_nodes_move_alone_until_a_step_is_as_predicted_or_their_iterations_are_over():
    progress = begun()
    assert progress.state_iterations == Strategies().state_iterations
    stepped(progress, 1.0, 0.5)
    assert progress.state_iterations == Strategies().state_iterations - 1
    stepped(progress, 1.0, 0.95)
    assert (progress.state_iterations, progress.gap_scale) == (0, 1.0)


def test_a_well_predicted_step_begins_the_next_stage_and_a_very_well_predicted_one_skips_it():
    progress = begun(states_first=False)
    stepped(progress, 1.0, 0.5)
    assert progress.gap_scale == 1.0
    stepped(progress, 1.0, 0.95)
    assert progress.gap_scale == pytest.approx(0.1)
    assert progress.continuity_variance[0] == pytest.approx(4.0 * 0.01)
    stepped(progress, 1.0, 1.0)
    assert progress.gap_scale == pytest.approx(0.001)
    stepped(progress, 1.0, 0.5, length=0.4)  # a shortened step is no prediction
    assert progress.gap_scale == pytest.approx(0.001)
    assert progress.homotopy_end is None
    stepped(progress, 1.0, 0.5, done=True)  # nothing is left to gain
    assert progress.is_exact
    assert progress.homotopy_end is not None


def test_switched_off_continuity_is_exact_at_once():
    assert begun(continuity_homotopy=False, states_first=False).is_exact
    assert not begun(states_first=False).is_exact


def test_multipliers_only_grow():
    progress = Progress.exact(Strategies())
    progress.begin(HERE, [np.ones(2)])

    def step(values):
        condensed = SimpleNamespace(largest_multiplier=lambda dz: np.array(values))
        return SimpleNamespace(condensed=[condensed], dz=np.zeros(1))

    progress.update_multipliers(step([1.0, 2.0]))
    progress.update_multipliers(step([3.0, 0.5]))
    assert np.all(progress.multipliers[0] > [3.0, 2.0])


def test_delays_are_held_once_and_only_where_continuity_is_exact():
    progress = begun()
    assert not progress.hold_delays()
    progress = Progress.exact(Strategies())
    assert progress.hold_delays()
    assert not progress.hold_delays()


def test_an_exact_iteration_moves_nodes_and_parameters_together_from_its_first_step():
    progress = Progress.exact(Strategies(states_first=True))
    assert (progress.is_exact, progress.state_iterations) == (True, 0)
    assert Progress(Strategies(), state_iterations=7).state_iterations == 7
