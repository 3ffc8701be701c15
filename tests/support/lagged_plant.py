"""A plant behind a lag, and a record of it without noise."""

from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

import greybox as gb

STEP = 0.01
TIME = STEP * np.arange(3000)


class Lagged(gb.StateSpace):
    """v' = a v + b w, behind a lag w' = (u - w) / tau, with a delay."""

    states, inputs, outputs = ("v", "w"), ("u",), ("v",)
    delays = {"u": "T"}
    a = gb.Parameter(-1.0, bounds=(-5, 0))
    b = gb.Parameter(3.0, bounds=(0, 9))
    tau = gb.Parameter(0.05, bounds=(0.01, 0.5))
    T = gb.Parameter(0.03, bounds=(0, 0.1))

    def derivative(self, x, u, p):
        return (p.a * x.v + p.b * x.w, (u.u - x.w) / p.tau)

    def output(self, x, u, p):
        return (x.v,)


TRUTH = np.array([-1.0, 3.0, 0.05, 0.03])


def force(t):
    return np.sin(1.7 * t) + 0.5 * np.sin(4.1 * t + 1)


@cache
def flown(count=TIME.size):
    time = TIME[:count]
    a, b, tau, T = TRUTH
    states = solve_ivp(
        lambda t, x: (a * x[0] + b * x[1], (force(t - T) - x[1]) / tau),
        (0, time[-1]),
        (0.0, 0.0),
        t_eval=time,
        rtol=1e-10,
        atol=1e-12,
    ).y
    return gb.Record(time, {"u": force(time), "v": states[0], "w": states[1]})
