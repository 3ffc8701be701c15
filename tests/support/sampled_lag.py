"""A lag as states, and noisy records of it with its exact response to a held input."""

import numpy as np

import greybox as gb

STEP = 0.02


class SampledLag(gb.StateSpace):
    """T y' = K u - y."""

    states, inputs, outputs = ("y",), ("u",), ("y",)
    K = gb.Parameter(1.0, bounds=(0.1, 10))
    T = gb.Parameter(1.0, bounds=(0.01, 5), unit="s")

    def derivative(self, x, u, p):
        return ((p.K * u.u - x.y) / p.T,)

    def output(self, x, u, p):
        return (x.y,)


def lag_record(seed=0, samples=200, K=2.0, T=0.3):
    time = STEP * np.arange(samples)
    u = np.sin(3 * time) + np.sin(7 * time)
    y = np.zeros(samples)
    for k in range(samples - 1):
        y[k + 1] = K * u[k] + (y[k] - K * u[k]) * np.exp(-STEP / T)
    noise = 0.02 * np.random.default_rng(seed).normal(size=samples)
    return gb.Record(time, {"u": u, "y": y + noise})


def lag_problem(seed=0, samples=200, **criterion):
    return gb.Problem(
        SampledLag(), lag_record(seed, samples), gb.OutputError(inputs="held", **criterion)
    )
