"""A spring that may harden, and records of it by SciPy."""

import numpy as np
from scipy.signal import lsim

import greybox as gb


class Spring(gb.StateSpace):
    """A mass with a spring that may harden, on which a force acts after a delay."""

    states = ("position", "velocity")
    inputs = ("force",)
    outputs = ("position",)
    delays = {"force": "delay"}
    stiffness = gb.Parameter(4.0, bounds=(0.1, 100), unit="1/s²")
    damping = gb.Parameter(0.8, bounds=(0, 10), unit="1/s")
    hardening = gb.Parameter(0.0, bounds=(-1, 10), unit="1/(m²·s²)", fixed=True)
    delay = gb.Parameter(0.0, bounds=(0, 0.4), unit="s", fixed=True)

    def derivative(self, x, u, p):
        spring = p.stiffness * x.position + p.hardening * x.position**3
        return (x.velocity, u.force - p.damping * x.velocity - spring)

    def output(self, x, u, p):
        return (x.position,)


def forced(duration, rate=50.0, seed=0):
    """Time, and a force of a few sines."""
    time = np.arange(round(duration * rate)) / rate
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, 5)
    return time, sum(
        np.sin(w * time + f) for w, f in zip((0.7, 1.3, 2.2, 3.9, 6.0), phases, strict=True)
    )


def driven(duration=20.0, noise=0.0, seed=0, **values):
    """A record of the linear spring from rest, simulated by scipy."""
    time, force = forced(duration, seed=seed)
    p = Spring().values(values)
    x = lsim(([[0, 1], [-p.stiffness, -p.damping]], [[0], [1]], [[1, 0]], 0), force, time)[1]
    error = np.random.default_rng([seed, 1]).normal(size=time.size)
    return gb.Record(
        time, {"force": force, "position": x + noise * error}, {"position": "m"}, name="spring"
    )
