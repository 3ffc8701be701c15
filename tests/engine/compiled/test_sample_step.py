"""What happens at one sample, number by number: delays, biases, missing outputs and innovations."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.engine.compiled.sample_step import RUN, sample_step
from greybox.modeling.realization import dynamics

STEP = 0.1


class Chain(gb.StateSpace):
    """Two states driven by two inputs, of which the second reaches an output at once and is
    late.
    """

    states, inputs, outputs = ("a", "b"), ("u", "w"), ("y", "z")
    delays = {"w": "tau"}
    k = gb.Parameter(2.0)
    tau = gb.Parameter(0.03)

    def derivative(self, x, u, p):
        return (x.b + u.w, -p.k * x.a + u.u)

    def output(self, x, u, p):
        return (x.a, x.b + 3 * u.w)


NAMES = ("k", "tau", "u_bias", "w_bias", "z_bias", "K_a_z", "K_b_y")
VALUES = np.array([2.0, 0.13, 0.5, 0.25, -0.2, 0.3, 0.7])


def made(held=(False, False), outputs=("y", "z")):
    biases = ("u", "w", "z")
    system = dynamics(Chain()).observed(outputs)
    return sample_step(system, held, NAMES, gb.RungeKutta(), 4, biases=biases, corrects_states=True)


def data(y=1.5, z=-0.4, present=(1, 1)):
    """Delays of 0 and 1 sample, three values of each input around them, outputs, which are
    there, and the step.
    """
    return np.array([0, 1, 1.0, 1.2, 1.8, 4.0, 5.0, 7.0, y, z, *present, STEP])


@pytest.mark.parametrize(
    ("held", "now"), [((False, False), 0.3 * 4 + 0.7 * 5), ((True, True), 4.0)]
)
def test_residuals_and_innovations_are_of_delayed_inputs_less_their_biases(held, now):
    """The second input is 1.3 samples late: three tenths of the way back to the sample before."""
    step, x = made(held), np.array([0.8, -0.6])
    corrected, mean, change, residual, simulated = (
        v.full().ravel() for v in step.measurement(x, VALUES, data())
    )
    outputs = np.array([0.8, -0.6 + 3 * (now - 0.25) - 0.2])
    assert_allclose(simulated, outputs)
    assert_allclose(residual, [1.5 - outputs[0], -0.4 - outputs[1]])
    assert_allclose(corrected, x + np.array([0.3 * residual[1], 0.7 * residual[0]]))
    if held[0]:  # three tenths of the step at the sample before
        assert_allclose(mean, [1.2 - 0.5, 0.3 * 4 + 0.7 * 5 - 0.25])
        assert_allclose(change, [0, 6 * 0.3 * 0.7])
    else:
        assert_allclose(mean[0], (1.2 + 1.8) / 2 - 0.5)
        assert_allclose(change[0], 0.6)
        t = np.linspace(0, 1, 200_001)
        late = np.interp(t - 0.3, [-1, 0, 1], [4.0, 5.0, 7.0])
        assert_allclose(mean[1], late.mean() - 0.25, rtol=1e-5)
        assert_allclose(change[1], 12 * np.mean(late * (t - 0.5)), rtol=1e-4)


def test_what_is_missing_corrects_nothing():
    x = np.array([0.8, -0.6])
    corrected, *_, residual, _ = (
        v.full().ravel() for v in made().measurement(x, VALUES, data(z=np.pi, present=(1, 0)))
    )
    assert_allclose(residual, [0.7, 0])
    assert_allclose(corrected, [0.8, -0.6 + 0.7 * 0.7])


def test_some_outputs_in_another_order():
    step, x = made(outputs=("z",)), np.array([0.8, -0.6])
    d = np.array([0, 1, 1.0, 1.2, 1.8, 4.0, 5.0, 7.0, -0.4, 1, STEP])
    corrected, *_, residual, _ = (v.full().ravel() for v in step.measurement(x, VALUES, d))
    assert_allclose(residual, [-0.4 - (-0.6 + 3 * (4.7 - 0.25) - 0.2)])
    assert_allclose(corrected, x + np.array([0.3 * residual[0], 0]))


def test_the_step_goes_on_from_the_corrected_state():
    step, x = made(), np.array([0.8, -0.6])
    corrected, mean, change, residual, simulated = (
        v.full().ravel() for v in step.measurement(x, VALUES, data())
    )
    after, same, alike = (v.full().ravel() for v in step.function(x, VALUES, data()))
    assert_allclose(same, residual)
    assert_allclose(alike, simulated)
    A, B = np.array([[0, 1], [-2.0, 0]]), np.array([[0, 1], [1, 0]])
    from scipy.integrate import solve_ivp

    wanted = solve_ivp(
        lambda t, x: A @ x + B @ (mean + change * (t / STEP - 0.5)),
        (0, STEP),
        corrected,
        rtol=1e-10,
        atol=1e-12,
    ).y[:, -1]
    assert_allclose(after, wanted, rtol=1e-7)


@pytest.mark.parametrize("samples", [1, RUN - 1, RUN, RUN + 1, 2 * RUN])
def test_a_simulation_is_one_step_after_the_other(samples):
    step, random = made(), np.random.default_rng(0)
    rows = np.tile(data(), (samples, 1))
    rows[:, 2:10] = random.normal(size=(samples, 8))
    states = step.simulate(np.array([0.3, -0.1]), VALUES, rows)
    assert states.shape == (samples + 1, 2)
    x = np.array([0.3, -0.1])
    for k, row in enumerate(rows):
        assert_allclose(states[k], x, rtol=1e-9, atol=1e-12)
        x = step.function(x, VALUES, row)[0].full().ravel()
    assert_allclose(states[-1], x, rtol=1e-9, atol=1e-12)


def test_a_fold_has_the_derivatives_of_its_steps():
    step, rows = made(), np.tile(data(), (3, 1)).T
    x, q = ca.MX.sym("x", 2), ca.MX.sym("q", len(NAMES))
    states, residuals = step.folded(3)(x, q, rows)
    slopes = ca.Function("slopes", [x, q], [ca.jacobian(states[:, 2], q), residuals])
    found = slopes([0.3, -0.1], VALUES)[0].full()
    for k in range(len(NAMES)):
        h = 1e-6 * np.eye(len(NAMES))[k]
        ends = [
            step.simulate(np.array([0.3, -0.1]), VALUES + sign * h, rows.T)[-1] for sign in (1, -1)
        ]
        assert_allclose(found[:, k], (ends[0] - ends[1]) / 2e-6, rtol=1e-6, atol=1e-9)
