"""A lateral aircraft model with five outputs, and exact simulations of linear models under process
noise."""

import numpy as np
from scipy.linalg import expm

import greybox as gb
from greybox.models.tilt import PAPER_G


class Lateral(gb.StateSpace):
    """Sideslip, roll and yaw of an aircraft at 40 m/s."""

    states, inputs = ("beta", "p", "r", "phi"), ("aileron", "rudder")
    outputs = ("beta", "p", "r", "phi", "a_y")
    Y_beta = gb.Parameter(-0.25, bounds=(-5, 5))
    L_beta = gb.Parameter(-10.0, bounds=(-100, 50))
    L_p = gb.Parameter(-3.0, bounds=(-30, 5))
    L_r = gb.Parameter(1.0, bounds=(-10, 10))
    N_beta = gb.Parameter(4.0, bounds=(-20, 40))
    N_p = gb.Parameter(-0.2, bounds=(-5, 5))
    N_r = gb.Parameter(-0.6, bounds=(-10, 5))
    L_aileron = gb.Parameter(20.0, bounds=(-100, 100))
    N_rudder = gb.Parameter(-5.0, bounds=(-50, 50))
    Y_rudder = gb.Parameter(0.05, bounds=(-2, 2))

    def derivative(self, x, u, p):
        return (
            p.Y_beta * x.beta - x.r + 0.25 * x.phi + p.Y_rudder * u.rudder,
            p.L_beta * x.beta + p.L_p * x.p + p.L_r * x.r + p.L_aileron * u.aileron,
            p.N_beta * x.beta + p.N_p * x.p + p.N_r * x.r + p.N_rudder * u.rudder,
            x.p,
        )

    def output(self, x, u, p):
        return (x.beta, x.p, x.r, x.phi, 40 / PAPER_G * (p.Y_beta * x.beta + p.Y_rudder * u.rudder))


LATERAL = dict(
    zip(
        Lateral.parameters,
        (-0.3, -12.0, -3.5, 1.2, 4.5, -0.25, -0.7, 22.0, -5.5, 0.06),
        strict=True,
    )
)


def discretized(A, B, intensity, step):
    """Return transition, input matrix and covariance of the noise over a step.

    Van Loan (1978), IEEE TAC 23.
    """
    n, m = B.shape
    held = np.zeros((n + m, n + m))
    held[:n, :n], held[:n, n:] = A, B
    held = expm(held * step)
    noise = expm(np.block([[-A, np.diag(np.square(intensity))], [np.zeros((n, n)), A.T]]) * step)
    return held[:n, :n], held[:n, n:], noise[n:, n:].T @ noise[:n, n:]


def disturbed(model, truth, inputs, step, process, sensors, seed):
    """Return a record of a linear model with this white noise on derivatives and outputs."""
    linear = gb.modeling.linearize(model, truth)
    n, random = len(model.states), np.random.default_rng(seed)
    intensity = [process.get(state, 0.0) for state in model.states]
    F, G, Q = discretized(linear.A, linear.B, intensity, step)
    left, singular, _ = np.linalg.svd(Q)
    root, x, rows = left * np.sqrt(singular), np.zeros(n), []
    for u in inputs.T:
        rows.append(linear.C @ x + linear.D @ u)
        x = F @ x + G @ u + root @ random.normal(size=n)
    size = np.array([sensors[name] for name in model.outputs])
    outputs = np.transpose(rows) + size[:, None] * random.normal(size=(len(size), inputs.shape[1]))
    signals = dict(zip(model.inputs, inputs, strict=True)) | dict(
        zip(model.outputs, outputs, strict=True)
    )
    return gb.Record(np.arange(inputs.shape[1]) * step, signals)


def doublets(count, samples, size, seed):
    """Return random doublets (count, samples) of twelve samples each."""
    random = np.random.default_rng([seed, 7])
    return np.array(
        [
            size * np.repeat(random.choice([-1, 0, 1], samples // 12 + 1), 12)[:samples]
            for _ in range(count)
        ]
    )
