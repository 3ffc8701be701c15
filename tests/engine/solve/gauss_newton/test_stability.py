"""Gains within an iteration, of gains whose poles and costs are stated."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from greybox.engine.solve.gauss_newton.iterate import Iterate
from greybox.engine.solve.gauss_newton.stability import (
    are_stable,
    best_gains,
    simulate_stable,
    stable_step,
)
from greybox.engine.solve.quadratic_program import solve_small_qp


class Gain:
    """One gain, which is stable below one.

    A filter of process noise of a variance has that as gain.
    """

    def __init__(self, place, diverges=False):
        self.place = place
        self.part = SimpleNamespace(trajectory=self.simulated)
        self.diverges = diverges

    def is_stable(self, trajectory):
        return trajectory.gain < 1

    def simulated(self, z, nodes, *, simulated):
        assert simulated
        return SimpleNamespace(
            gain=z[self.place], nodes=nodes, simulated=True, finite=not self.diverges
        )

    def filtered(self, trajectory, z, variance):
        z = z.copy()
        z[self.place] = variance[0] if variance[0] < 1 else np.nan
        return z

    def simulated_cost(self, z, nodes):
        return (np.log10(z[self.place]) - nodes) ** 2  # least at the decade that the nodes say


def along(gain, *, simulated=False, nodes=0.0):
    return SimpleNamespace(gain=gain, nodes=nodes, simulated=simulated, finite=True)


def parts_of(*gains, weights=(1.0, 1.0), low=0.0):
    for gain, weight in zip(gains, weights, strict=False):
        if gain is not None:
            gain.part.weight = weight
    limits = SimpleNamespace(clipped=lambda z: np.maximum(z, low))
    return SimpleNamespace(gains=gains, limits=limits)


def test_predictors_are_stable_together_and_those_that_are_simulated_alone():
    parts = parts_of(Gain(0), None, Gain(1), weights=(1, 1, 1))
    lost = Iterate(np.zeros(2), (along(0.5), along(9.0), along(2.0)))
    assert not are_stable(parts, lost)
    assert are_stable(parts, lost, simulated=True)
    assert not are_stable(
        parts, Iterate(lost.z, (*lost.trajectories[:2], along(2.0, simulated=True))), simulated=True
    )
    assert are_stable(
        parts, Iterate(lost.z, (along(0.5, simulated=True), along(9.0, simulated=True), along(0.9)))
    )


@pytest.mark.parametrize(("gain", "began", "diverges", "simulated"), [
    (0.5, False, False, True), (1.5, False, False, False), (0.5, False, True, False), (0.5, True, True, True),
])  # fmt: skip
def test_stable_predictors_are_simulated_where_they_stay_finite(gain, began, diverges, simulated):
    trajectory, other = along(gain, simulated=began, nodes=7.0), along(0.1)
    found = simulate_stable(
        parts_of(Gain(0, diverges=diverges), None), Iterate(np.array([gain]), (trajectory, other))
    )
    first, second = found.trajectories
    assert second is other
    assert (first.gain, first.nodes, first.simulated) == (gain, 7.0, simulated)
    assert (first is trajectory) == (began or not simulated)


class CurvedGain(Gain):
    """A gain that is stable within a circle of radius one around the origin."""

    def __init__(self):
        self.part = SimpleNamespace()

    def moved(self, trajectory, z):
        return z

    def is_stable(self, z):
        return np.hypot(*z) <= 1

    def room(self, z):
        return np.array([1 - z @ z])


@pytest.mark.parametrize("wanted", [(0.3, 0.4), (0.9, 0.9), (0.6, 0.9), (1.0, 0.3)])
def test_a_step_to_an_unstable_predictor_goes_along_the_limit(wanted):
    z, wanted = np.array([0.8, 0.59]), np.array(wanted)
    own = np.array([[1.0, 0.0]]), np.array([-1.0])  # the first variable falls by one at most

    def solve(normals, limits):
        assert_allclose(normals[0], own[0][0])
        return solve_small_qp(np.eye(2), z - wanted, normals, limits)

    def step(simulated):
        trajectory = along(0.5, simulated=simulated)
        iterate = Iterate(z, (trajectory, trajectory))
        return stable_step(parts_of(CurvedGain(), None), iterate, own, solve)

    free, *limits = step(False)  # in segments
    assert_allclose(free, solve(*own))
    assert [len(rows) for rows in limits] == [1, 1]
    dz, *limits = step(True)
    if np.hypot(*(z + free)) <= 1:
        assert_allclose(dz, free)
        assert [len(rows) for rows in limits] == [1, 1]
        return
    assert [len(rows) for rows in limits] == [2, 2]
    assert np.hypot(*(z + dz)) <= 1
    assert dz[0] >= -1 - 1e-9
    # It comes nearer to what is wanted than a step that is only shortened.
    shares = np.linspace(0, 1, 1001)[:, None]
    inside = [share for share in shares if np.hypot(*(z + share * free)) <= 1]
    shortened = z + inside[-1] * free
    assert np.linalg.norm(z + dz - wanted) < np.linalg.norm(shortened - wanted) + 1e-9


@pytest.mark.parametrize(
    ("own", "taken"), [(10.0**-5.1, "own"), (10.0**-5.3, "filter"), (1.2, "filter")]
)
def test_the_best_gains_are_those_of_the_cheapest_filters_of_one_size_or_the_own(own, taken):
    """In decades of gain, two parts want -4.1 and -6.1.

    The nearest filter is that of -5 for both.
    """
    parts = parts_of(Gain(0), None, Gain(1), weights=(1.0, 5.0, 1.0))
    iterate = Iterate(
        np.array([own, own]), (along(own, nodes=-4.1), along(0.0), along(own, nodes=-6.1))
    )
    found = best_gains(parts, iterate, [np.ones(1)] * 3)
    assert_allclose(found, [own, own] if taken == "own" else [1e-5, 1e-5])


def test_a_weight_counts_and_what_no_filter_serves_stays():
    parts = parts_of(Gain(0), Gain(1), weights=(9.0, 1.0))
    iterate = Iterate(np.array([2.0, 2.0]), (along(2.0, nodes=-4.0), along(2.0, nodes=-8.9)))
    assert_allclose(best_gains(parts, iterate, [np.ones(1), np.ones(1)]), [1e-4, 1e-4])
    other = Iterate(iterate.z, (along(2.0, nodes=-4.0), along(2.0, nodes=-12.0)))
    assert_allclose(best_gains(parts, other, [np.ones(1), np.ones(1)]), [1e-5, 1e-5])
    assert best_gains(parts, iterate, [np.full(1, 1e20)] * 2).tolist() == [2.0, 2.0]
    clipped = parts_of(Gain(0), Gain(1), weights=(9.0, 1.0), low=1e-3)
    assert_allclose(best_gains(clipped, iterate, [np.ones(1), np.ones(1)]), [1e-3, 1e-3])
