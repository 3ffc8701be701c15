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


SETTINGS = Strategies()


def test_multipliers_exceed_the_largest_so_far_by_a_fifth_where_continuity_is_exact():
    def step(values):
        condensed = SimpleNamespace(largest_multiplier=lambda dz: np.array(values) * dz)
        return SimpleNamespace(condensed=[condensed], dz=np.full(1, 2.0))

    progress = Progress.exact(SETTINGS)
    progress.begin(HERE, [np.ones(2)])
    assert progress.multipliers[0].tolist() == [0, 0]
    first = step([1.0, 2.0])
    assert progress.update_multipliers(first) is first
    progress.update_multipliers(step([3.0, 0.5]))
    assert progress.multipliers[0] == pytest.approx([7.2, 4.8])
    relaxed = begun()
    relaxed.update_multipliers(step([3.0, 0.5]))
    assert relaxed.multipliers[0].tolist() == [0]
    assert (relaxed.start[0], relaxed.start[1]) == (HERE.z, HERE.nodes)


def test_what_an_iteration_begins_with():
    progress = Progress(SETTINGS)
    assert (progress.last_scale, progress.constraint_penalty) == (
        SETTINGS.last_gap,
        SETTINGS.constraint_penalty,
    )
    assert progress.full_damping == pytest.approx(0.01 * SETTINGS.first_damping)
    assert (progress.gap_scale, progress.damping, progress.is_exact) == (1.0, 0.0, False)
    assert not Progress(SETTINGS, near_solution=True).is_exact  # the nodes move alone first
    assert Progress(Strategies(states_first=False), near_solution=True).is_exact
    assert not Progress(Strategies(continuity_homotopy=False)).is_exact
    assert Progress(Strategies(states_first=False), state_iterations=5).state_iterations == 0


@pytest.mark.parametrize("near", [False, True])
def test_from_near_a_solution_continuity_is_demanded_once_the_nodes_have_moved(near):
    progress = Progress(SETTINGS, near_solution=near, state_iterations=2)
    progress.begin(HERE, [np.array([4.0])])
    stepped(progress, 1.0, 0.1)
    assert (progress.state_iterations, progress.gap_scale) == (1, 1.0)
    stepped(progress, 1.0, 0.1)
    assert (progress.state_iterations, progress.is_exact) == (0, near)
    assert (progress.homotopy_end is not None) == near


@pytest.mark.parametrize(
    ("error", "length", "stages"),
    [
        (0.99 * SETTINGS.kept_promise, 1.0, 1),
        (1.01 * SETTINGS.kept_promise, 1.0, 0),
        (-0.99 * SETTINGS.kept_promise, 1.0, 1),
        (-1.01 * SETTINGS.kept_promise, 1.0, 0),
        (0.99 * SETTINGS.well_kept_promise, 1.0, 2),
        (1.01 * SETTINGS.well_kept_promise, 1.0, 1),
        (0.0, 0.999, 0),
    ],
)
@pytest.mark.parametrize("skipped", [True, False])
def test_stages_go_on_by_how_well_a_full_step_was_predicted(error, length, stages, skipped):
    """The decrease of 50, of which so much more or less came true."""
    progress = begun(states_first=False, skipped_stages=skipped, last_gap=1e-9)
    stepped(progress, 50.0, 50.0 * (1 + error), length=length)
    wanted = SETTINGS.gap_reduction ** (stages if skipped else min(stages, 1))
    assert progress.gap_scale == pytest.approx(wanted)


def test_a_step_that_promises_nothing_predicts_nothing():
    progress = begun(states_first=False)
    for promised in (0.0, -1.0):
        stepped(progress, promised, promised)
        assert progress.gap_scale == 1.0
    stepped(progress, 0.0, 0.0, done=True)
    assert progress.gap_scale == pytest.approx(SETTINGS.gap_reduction)


@pytest.mark.parametrize(("last", "exact"), [(0.099, False), (0.1, True), (0.101, True)])
def test_continuity_is_exact_from_the_last_scale_on(last, exact):
    progress = begun(states_first=False, gap_reduction=0.1)
    progress.last_scale = last
    stepped(progress, 1.0, 0.5, done=True)
    assert progress.is_exact is exact
    assert progress.gap_scale == (0.0 if exact else 0.1)


def test_held_delays_begin_without_damping():
    progress = Progress.exact(SETTINGS)
    progress.damping, progress.last_decrease = 3.0, 0.5
    assert progress.hold_delays()
    assert progress.damping == 0.0
    assert np.isnan(progress.last_decrease)
