"""Disturbances of a user's own, held against a Kalman filter written here and against a truth."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from lateral_aircraft import discretized, disturbed, doublets
from numpy.testing import assert_allclose
from recipes import Waves
from scipy.linalg import solve_discrete_are
from spring_lag_tilt import SPRING, Spring, assert_true, fit_finely as fit

import greybox as gb
from greybox.modeling.disturbance import FirstOrderGust, gust_time

pytestmark = pytest.mark.usefixtures("unjudged_file")

SEA = gb.PredictionError(disturbance={"v": Waves()}, inputs="held")
TRUTH = {name: SPRING[name] for name in ("k", "c", "b")} | {"peak_v": 1.2}
SENSORS = {"x": 0.05, "v": 0.15}
STEP = 0.05


def at_sea(seed=1, n=500):
    """A record of the spring on waves, and its problem."""
    still = {name: TRUTH[name] for name in ("k", "c", "b")}
    calm = disturbed(Spring(), still, doublets(1, n, 1.0, seed), STEP, {}, SENSORS, seed)
    model = gb.Problem(Spring(), calm, SEA).model
    assert model.states == ("x", "v", "swell_v", "heave_v")
    inputs = doublets(1, n, 1.0, seed)
    record = disturbed(model, TRUTH, inputs, STEP, {"swell_v": 0.8}, SENSORS, seed)
    return gb.Problem(Spring(), record, SEA)


def likelihood(values, first, record):
    """Return the negative logarithm of the likelihood, by the steady filter of four states."""
    k, c, b, peak, w, v_x, v_v = values
    A = np.array(
        [
            [0, 1, 0, 0],
            [-k, -c, 1, 0],
            [0, 0, -0.2 * peak, -(peak**2)],
            [0, 0, 1, 0],
        ]
    )
    B = np.array([[0], [b], [0], [0]])
    F, G, Q = discretized(A, B, [0, 0, w, 0], STEP)
    C, V = np.eye(2, 4), np.diag([v_x**2, v_v**2])
    P = solve_discrete_are(F.T, C.T, Q, V)
    S = C @ P @ C.T + V
    K = P @ C.T @ np.linalg.inv(S)

    y, force = np.array([record["x"], record["v"]]).T, record["F"]
    x, errors = first, []
    for measured, u in zip(y, force, strict=True):
        errors.append(measured - C @ x)
        x = F @ (x + K @ errors[-1]) + G[:, 0] * u
    squares = np.einsum("ki,ij,kj->", errors, np.linalg.inv(S), errors)
    return 0.5 * (len(y) * np.linalg.slogdet(2 * np.pi * S)[1] + squares)


def test_waves_of_a_users_file_have_the_likelihood_of_a_kalman_filter(tmp_path):
    problem = at_sea()
    found = fit(problem, starts=[TRUTH])
    record = problem.data
    assert_true(found, TRUTH | {"w_swell_v": 0.8, "v_x": 0.05, "v_v": 0.15}, 3.0)

    names = ("k", "c", "b", "peak_v", "w_swell_v", "v_x", "v_v")
    values = [found.estimate[name] for name in names]
    first = np.array([found.records[0].initial[s][0] for s in problem.model.states])
    assert found.cost == pytest.approx(likelihood(values, first, record), abs=1e-2)

    gb.save(found, tmp_path / "sea.h5")
    loaded = gb.load(tmp_path / "sea.h5", models=[problem.model])
    assert loaded.model_of(0).states == problem.model.states
    assert loaded.estimate == found.estimate


@dataclass(frozen=True)
class OwnLag(gb.formulation.Disturbance):
    """What "colored" is, written by a user."""

    states: ClassVar[tuple[str, ...]] = ("gust",)
    driven: ClassVar[tuple[str, ...]] = ("gust",)

    def parameters(self, state, times):
        return {"T_gust": gust_time(times, state)}

    def derivative(self, x, p):
        return [-x.gust / p.T_gust]


def test_the_included_disturbance_written_by_a_user_gives_its_estimate():
    record = at_sea(n=200).data
    fits = [
        fit(gb.Problem(Spring(), record, gb.PredictionError(disturbance={"v": color})), starts=2)
        for color in ("colored", OwnLag())
    ]
    assert_allclose([*fits[0].estimate.values()], [*fits[1].estimate.values()], rtol=1e-7)


def test_an_included_disturbance_has_its_name_and_others_are_refused():
    by_class = gb.PredictionError(disturbance={"v": FirstOrderGust()})
    assert by_class == gb.PredictionError(disturbance={"v": "colored"})
    with pytest.raises(ValueError, match="give 'colored' or a gb"):
        gb.PredictionError(disturbance={"v": "dryden"})
    with pytest.raises(ValueError, match="state 'w'"):
        gb.Problem(Spring(), at_sea(n=200).data, gb.PredictionError(disturbance={"w": Waves()}))
