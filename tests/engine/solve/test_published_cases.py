"""Identifications of other vehicles and machines.

What they ask of a framework that a tilt loop does not.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from hard_models import LOTKA_VOLTERRA, Pendulum, free_motion, lotka_volterra, slow_pendulum

import greybox as gb
from greybox.assessment.checks.coarse_integration import coarse_integration
from greybox.assessment.checks.evidence import Evidence
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.covariance.covariance import accuracy_at
from greybox.engine.solve.discretization_error import discretization_error, refine_discretization
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.engine.solve.multistart import multistart
from greybox.engine.solve.search_method import solver_for
from greybox.models.tilt import PAPER_G

pytestmark = pytest.mark.usefixtures("unjudged_file")


def point(problem, **values):
    """Return the compiled problem, its first record, and the solver's variables at these parameters."""
    nlp = compile_problem(problem)
    z = nlp.scaling.to_solver(np.array([values[name] for name in nlp.free]))
    return nlp, nlp.parts[0], z


def test_a_model_without_inputs_sampled_sparsely():
    fit = gb.fit(lotka_volterra(), starts=5, progress=False, profiles=False)
    assert fit.converged
    for name, value in LOTKA_VOLTERRA.items():
        assert abs(fit.estimate[name] - value) < 3.5 * fit.standard_error[name]


@pytest.fixture(scope="module")
def pendulum():
    return slow_pendulum().data


def coarse(record, substeps=None):
    """Return a fit whose substeps are few, as a choice by stability alone makes them."""
    problem = gb.Problem(Pendulum(), record)
    nlp = compile_problem(problem, gb.MultipleShooting(integrator=gb.RungeKutta(substeps=substeps)))
    return nlp, multistart(solver_for(nlp), np.array([[39.0, 0.1]]))


def test_too_few_substeps_are_told_from_their_shift(pendulum):
    nlp, search = coarse(pendulum, substeps=2)
    assert search.converged
    solver = GaussNewton(nlp)
    profile = solver.profile(search.minima[0].estimate, search.nodes)
    assert discretization_error(nlp, profile.trajectories).largest > 1
    accuracy = accuracy_at(nlp, search.minima[0].estimate, profile.trajectories)
    evidence = Evidence(SimpleNamespace(error=None), accuracy, None)
    (finding,) = coarse_integration(evidence)
    assert "twice the steps per sample (4 instead of 2)" in finding.text
    # What the method fixes stays.
    assert refine_discretization(search, solver) == (search, solver, None)


def test_the_shift_is_that_of_a_second_fit(pendulum):
    found = []
    for substeps in (40, 80):
        nlp, search = coarse(pendulum, substeps)
        profile = GaussNewton(nlp).profile(search.minima[0].estimate, search.nodes)
        found.append(
            (search.minima[0].estimate, discretization_error(nlp, profile.trajectories).shift)
        )
    errors = np.array([0.010, 0.00032])  # of k and c at this noise
    assert np.all(np.abs((found[1][0] - found[0][0]) / errors - found[0][1]) < 0.05)
    assert np.abs(found[1][1]).max() < 0.1


def test_substeps_are_refined_until_the_truth_is_found(pendulum):
    nlp, search = coarse(pendulum)
    refined, solver, _ = refine_discretization(search, GaussNewton(nlp))
    profile = solver.profile(refined.minima[0].estimate, refined.nodes)
    assert discretization_error(solver.nlp, profile.trajectories).largest <= 0.1
    assert np.all(
        np.abs(refined.minima[0].estimate - [39, 0.08]) < 3.5 * np.array([0.010, 0.00032])
    )


def test_an_undamped_oscillation_gets_substeps_by_its_frequency(pendulum):
    # One step of Runge-Kutta is stable up to |pole| · step = 2.7, and here, at 2.5, wrong.
    nlp = compile_problem(gb.Problem(Pendulum(), pendulum))
    assert nlp.parts[0].substeps >= np.sqrt(39) * 0.4 / 0.7


class Airspeed(gb.StateSpace):
    """Airspeed and angle of attack of a glider, which no airspeed of zero allows.

    The density of the air is hidden.
    """

    states = ("V", "alpha", "rho")
    inputs = ("gamma",)
    outputs = ("V", "lift")
    drag = gb.Parameter(0.01, bounds=(0.001, 0.1))
    lift = gb.Parameter(0.05, bounds=(0.01, 1))

    def derivative(self, x, u, p):
        return (
            -p.drag * x.rho * x.V**2 - PAPER_G * gb.sin(u.gamma),
            PAPER_G / x.V - p.lift * gb.sqrt(x.rho) * x.V * x.alpha,
            -0.01 * gb.log(x.rho),
        )

    def output(self, x, u, p):
        return (x.V, gb.sqrt(x.rho) * x.V * x.alpha)


def test_first_states_lie_where_the_model_is_finite():
    time = 0.1 * np.arange(45)
    speed = 30 + np.sin(time)
    record = gb.Record(
        time, {"gamma": -0.1 + 0.02 * np.cos(time), "V": speed, "lift": 6 + 0.1 * np.sin(time)}
    )
    _, part, z = point(gb.Problem(Airspeed(), record), drag=0.001, lift=0.05)
    trajectory = part.trajectory(z)
    assert np.allclose(
        trajectory.nodes[:, 0], speed[:: part.data.segment_length]
    )  # an output shows it
    assert np.all(trajectory.nodes[:, 2] > 0)
    assert trajectory.finite
    assert not part.trajectory(z, np.zeros_like(trajectory.nodes)).finite


class Bicycle(gb.StateSpace):
    """Side slip and yaw rate of a car.

    Its measured speed divides, and so must not end with the record.
    """

    states = ("v", "r")
    inputs = ("speed", "steer")
    outputs = ("r",)
    C = gb.Parameter(50.0, bounds=(5, 500), scale="log", unit="N/(kg·rad)")

    def derivative(self, x, u, p):
        front, rear = u.steer - (x.v + 1.2 * x.r) / u.speed, -(x.v - 1.5 * x.r) / u.speed
        return (p.C * (front + rear) - u.speed * x.r, p.C * (front - 1.1 * rear))

    def output(self, x, u, p):
        return (x.r,)


def test_a_last_segment_is_not_filled_up_with_inputs_of_zero():
    time = 0.02 * np.arange(203)

    def derivative(t, x):
        front, rear = 0.05 * np.sin(3 * t) - (x[0] + 1.2 * x[1]) / 20, -(x[0] - 1.5 * x[1]) / 20
        return [60 * (front + rear) - 20 * x[1], 60 * (front - 1.1 * rear)]

    x = free_motion(derivative, [0, 0], time)
    noisy = x[1] + 0.002 * np.random.default_rng(0).standard_normal(203)
    record = gb.Record(
        time, {"speed": np.full(203, 20.0), "steer": 0.05 * np.sin(3 * time), "r": noisy}
    )
    fit = gb.fit(gb.Problem(Bicycle(), record), starts=3, progress=False, profiles=False)
    assert fit.converged
    assert abs(fit.estimate["C"] - 60) < 3.5 * fit.standard_error["C"]
