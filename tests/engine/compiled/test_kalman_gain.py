"""Predictors: their gains, held against Riccati's equation, and fits of flights in wind, held
against the truth.
"""

from functools import cache

import numpy as np
import pytest
from hard_models import ROTOR, WIND, BlindTilt, pushed, windy_flight
from numpy.testing import assert_allclose
from spring_lag_tilt import SPRING, TILT, FullTilt, Spring, assert_true, fit_finely as fit, steps

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.compiled.kalman_gain import kalman_gain
from greybox.engine.compiled.riccati import steady_state_gain

pytestmark = pytest.mark.usefixtures("unjudged_file")

# --- the filter


@pytest.mark.parametrize("growth", [0.5, 0.99, 1.0, 1.3])
def test_the_steady_gain_solves_the_equation_of_riccati(growth):
    from scipy.linalg import solve_discrete_are

    random = np.random.default_rng(3)
    for outputs in (1, 2, 4):
        F, C = random.normal(size=(4, 4)), random.normal(size=(outputs, 4))
        F *= growth / np.abs(np.linalg.eigvals(F)).max()
        process = 10.0 ** random.uniform(-8, 2, size=4)
        P = solve_discrete_are(F.T, C.T, np.diag(process), np.eye(outputs))
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + np.eye(outputs))
        assert_allclose(steady_state_gain(F, C, process), K, rtol=1e-6, atol=1e-9)


def test_what_no_output_shows_has_no_steady_state_gain():
    assert np.isnan(
        steady_state_gain(np.diag([0.5, 1.2]), np.array([[1.0, 0.0]]), np.ones(2))
    ).all()


# --- the states


def spring_flight(n=1234, seed=0, **wind):
    noise = {"x": 0.02, "v": 0.06}
    options = {"rate": 20.0, "noise": noise, "process_noise": wind or {"v": 1.0}, "seed": seed}
    return gb.virtual_flight(Spring(), SPRING, excitation={"F": steps(n, seed)}, **options)


def test_a_predictor_follows_every_stretch_as_segments_that_join_do():
    whole = spring_flight()
    gaps = whole.with_signals(F=np.where(np.isin(np.arange(1234), (7, 400)), np.nan, whole["F"]))
    nlp = compile_problem(gb.Problem(Spring(), gaps, WIND))
    (part,) = nlp.parts
    values = SPRING | {"K_x_x": 0.3, "K_x_v": 0.05, "K_v_x": 0.5, "K_v_v": 0.6}
    z = nlp.scaling.to_solver(np.array([values[name] for name in nlp.free]))
    nodes = np.random.default_rng(0).normal(size=(part.data.segments, 2))
    followed = part.trajectory(z, nodes, simulated=True)
    joined = part.trajectory(z, followed.nodes)
    assert np.abs(joined.gaps).max() < 1e-12
    assert_allclose(followed.states, joined.states, atol=1e-12)
    assert_allclose(followed.ends, joined.ends, atol=1e-12)
    assert_allclose(followed.products, joined.products, rtol=1e-10)


# --- fits

# At 100 Hz, one step a sample is as good as four.
QUICK = gb.MultipleShooting(integrator=gb.RungeKutta(1))


def test_all_starts_end_in_one_minimum_with_all_gains_free():
    problem = gb.Problem(FullTilt(), windy_flight(2, {"q": 2.0}, 12), WIND, fixed=ROTOR)
    found = fit(problem, starts=2, method=QUICK)
    assert len([name for name in found.free if name.startswith("K_")]) == 12
    assert (found.agreeing, found.converged) == (2, True)
    assert_true(found, {name: value for name, value in TILT.items() if name not in ROTOR})


def test_standard_errors_of_a_predictor_use_the_residuals_not_the_deviations_that_were_given():
    flown = spring_flight()

    def found(factor):
        noise = {"x": 0.02 * factor, "v": 0.06 * factor}
        return fit(gb.Problem(Spring(), flown, gb.PredictionError(noise=noise)), starts=1)

    right, tripled = found(1.0), found(3.0)
    for name, error in right.standard_error.items():
        assert tripled.estimate[name] == pytest.approx(right.estimate[name], abs=0.01 * error)
        assert tripled.standard_error[name] == pytest.approx(error, rel=0.01)


def test_a_likelihood_that_grows_toward_the_limit_of_stability_is_no_stall():
    """The velocity is not measured and hardly disturbed: its pole would leave the unit circle."""
    problem = gb.Problem(BlindTilt(), windy_flight(3, {"q": 0.3}, 12), WIND, fixed=ROTOR)
    found = fit(problem, starts=1, method=QUICK)
    assert [run.status for run in found.runs] == ["converged"]
    assert_true(found, {name: value for name, value in TILT.items() if name not in ROTOR})


def test_what_innovations_do_not_drive_need_not_be_forgotten():
    found = fit(pushed())
    assert_true(found, {name: SPRING[name] for name in ("k", "c", "b")})
    assert abs(found.records[0].initial["w"][0] - 2.0) < 1.0


def test_a_fit_of_prediction_errors_takes_as_few_iterations_as_one_of_output_errors():
    data = windy_flight(0, {"v": 0.5, "q": 0.5}, 6)
    output, prediction = (
        sum(
            run.iterations
            for run in fit(gb.Problem(FullTilt(), data, rule, fixed=ROTOR), starts=1).runs
        )
        for rule in (gb.OutputError(inputs="held"), WIND)
    )
    assert prediction <= 1.5 * output


# --- where its poles are


@cache
def compiled_spring(*process_noise):
    criterion = gb.PredictionError(process_noise=process_noise, inputs="held")
    return compile_problem(gb.Problem(Spring(), spring_flight(600), criterion))


def spring_gain(*process_noise, **values):
    """Of 600 samples at 20 Hz, whose transition has poles of magnitude exp(-0.03); they must be
    within 1 - 3/600.
    """
    nlp = compiled_spring(*process_noise)
    z = nlp.scaling.to_solver(np.array([(SPRING | values).get(name, 0.0) for name in nlp.free]))
    (part,) = nlp.parts
    return kalman_gain(part), part.trajectory(z), z


@pytest.mark.parametrize(
    ("radius", "is_stable", "is_at_limit"),
    [
        (0.5, True, False),
        (0.99488, True, False),
        (0.99492, True, True),
        (0.99498, True, True),
        (0.99502, False, True),
    ],
)
def test_a_predictor_is_stable_within_the_limit_and_at_it_within_a_fiftieth_of_the_distance(
    radius, is_stable, is_at_limit
):
    corrected = 1 - radius / np.exp(-0.03)
    gain, trajectory, _ = spring_gain(K_x_x=corrected, K_v_v=corrected)
    assert gain.limit == pytest.approx(0.995)
    assert_allclose(np.abs(np.linalg.eigvals(gain.error_transition(trajectory))), radius, rtol=1e-6)
    assert gain.is_stable(trajectory) is is_stable
    assert gain.is_at_limit(trajectory) is is_at_limit


@pytest.mark.parametrize("coupling", [0.0, 0.02, 0.9])
def test_poles_are_as_far_from_the_limit_as_the_criterion_of_jury_says(coupling):
    """A pair of poles, and two that are real."""
    gain, trajectory, z = spring_gain(K_x_x=0.4, K_x_v=0.01, K_v_x=coupling, K_v_v=0.1)
    r = gain.radius(trajectory)
    A = gain.error_transition(trajectory)
    total, product = np.trace(A), np.linalg.det(A)
    wanted = [r**2 - product, r**2 + product - r * total, r**2 + product + r * total]
    assert_allclose(gain.room(gain.moved(trajectory, z)), wanted, rtol=1e-9)
    assert r == gain.limit


def test_the_unknowns_of_a_filter_are_process_noise_of_a_given_variance_and_residuals():
    gain, trajectory, z = spring_gain("v", w_v=0.4, v_x=0.06, v_v=0.09)
    filtered = gain.filtered(trajectory, z, np.array([7.0, 0.02]))
    found = gain.part.place(filtered).q[gain.unknowns]
    variance = (gain.part.residuals(trajectory) ** 2).mean(axis=1)
    names = gain.part.model.parameters
    assert [names[k] for k in gain.unknowns] == ["w_v", "v_x", "v_v"]
    assert_allclose(found, [np.sqrt(0.02 / 0.05), *np.sqrt(variance)])
