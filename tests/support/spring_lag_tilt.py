"""A spring, a lag and a tilt plant with records of them, and what a fit to such a record is held
against."""

import numpy as np
from scipy.signal import lfilter, lsim

import greybox as gb
from greybox.models.controller import AttitudeController
from greybox.models.tilt import NonlinearTilt

HELD = gb.OutputError(inputs="held")
ONE = [{}]  # a single start, the declared one
FINE = gb.MultipleShooting(integrator=gb.RungeKutta(4))


class FullTilt(NonlinearTilt):
    """With the outputs of a flight log."""

    outputs = ("v", "q", "theta")

    def output(self, x, u, p):
        return (x.v, x.q, x.theta)


class Spring(gb.StateSpace):
    """A mass on a spring with damping, driven by a late force."""

    states = ("x", "v")
    inputs = ("F",)
    outputs = ("x", "v")
    delays = {"F": "d"}
    k = gb.Parameter(6.0, bounds=(0.1, 100), unit="1/s²")
    c = gb.Parameter(0.8, bounds=(0, 20), unit="1/s")
    b = gb.Parameter(1.5, bounds=(-50, 50), unit="1/kg")
    d = gb.Parameter(0.0, bounds=(0, 0.2), unit="s", fixed=True)

    def derivative(self, x, u, p):
        return (x.v, -p.k * x.x - p.c * x.v + p.b * u.F)

    def output(self, x, u, p):
        return (x.x, x.v)


class Lag(gb.TransferFunction):
    """First order with a delay."""

    K = gb.Parameter(1.0, bounds=(-20, 20))
    T = gb.Parameter(0.3, bounds=(0.01, 10), unit="s")
    d = gb.Parameter(0.0, bounds=(0, 0.5), unit="s", fixed=True)

    def response(self, s, p):
        return p.K / (p.T * s + 1) * gb.exp(-s * p.d)


TILT = {
    "a1": -2.0,
    "a2": 4.0,
    "a3": 3.0,
    "a4": 200.0,
    "C_x": 0.08,
    "T_rotor": 0.048,
    "T_delay": 0.0137,
}
SPRING = {"k": 9.0, "c": 1.2, "b": 4.0}
LAG = {"K": 3.0, "T": 0.2}


def fit(problem, starts=ONE, *, profiles=False, **options):
    return gb.fit(problem, starts=starts, progress=False, profiles=profiles, **options)


def fit_finely(problem, starts=ONE, **options):
    """Fit with steps that need no refinement, which would take as long as the fit."""
    return fit(problem, starts, **{"method": FINE, **options})


def deviations(found, truth):
    """Errors of the estimate in standard errors."""
    return {
        name: (found.estimate[name] - value) / found.standard_error[name]
        for name, value in truth.items()
    }


def assert_true(found, truth, most=3.5):
    assert found.converged
    off = deviations(found, truth)
    assert all(abs(z) < most for z in off.values()), off


def steps(n, seed=0, hold=8, channel=0):
    return np.repeat(np.random.default_rng([seed, channel, 77]).normal(size=n // hold + 1), hold)[
        :n
    ]


def spring(n=300, rate=20.0, seed=0, noise=0.05, values=SPRING, force=None, **options):
    """A record of the spring with held forces, and white noise on both outputs."""
    force = steps(n, seed) if force is None else force
    sigma = {"x": noise, "v": 3 * noise}
    return gb.virtual_flight(
        Spring(), values, excitation={"F": force}, rate=rate, noise=sigma, seed=seed, **options
    )


def lag(delay, held, n=400, step=0.05, noise=0.0, seed=0, fine=100):
    """A record of the lag, exact.

    Linear between points of a fine grid, on which the delay falls.
    """
    u = (
        steps(n, seed, hold=3)
        if held
        else lfilter([1], [1, -0.6], np.random.default_rng(seed).normal(size=n))
    )
    time = np.arange(n) * step
    late = np.arange((n - 1) * fine + 1) / fine - delay / step  # in samples
    if held:
        # The mean of every fine interval: what a held input does over it.
        between = late[:-1] + 0.5 / fine
        drive = LAG["K"] * u[np.clip(np.floor(between), 0, n - 1).astype(int)]
        decay = np.exp(-step / fine / LAG["T"])
        y = np.concatenate([[0.0], lfilter([1 - decay], [1, -decay], drive)])
    else:
        drive = np.interp(late, np.arange(n), u)
        y = lsim(
            ([[-1 / LAG["T"]]], [[1 / LAG["T"]]], [[LAG["K"]]], 0),
            drive,
            late * step - late[0] * step,
        )[1]
    error = noise * np.random.default_rng([seed, 1]).normal(size=n)
    return gb.Record(time, {"u": u, "y": y[::fine] + error})


def tilt_flight(seconds=60, seed=0):
    """The paper's closed loop with noise on all outputs, flown and logged at 100 Hz."""
    time, waves = np.arange(int(seconds * 100)) / 100, np.geomspace(0.5, 16, 9)
    phases = np.random.default_rng(5).uniform(0, 2 * np.pi, 9)
    reference = 0.08 * sum(np.sin(w * time + f) for w, f in zip(waves, phases, strict=True))
    noise = {"v": 0.05, "q": 0.02, "theta": 0.005}
    controller = AttitudeController(rate=100.0)
    return gb.virtual_flight(
        FullTilt(),
        TILT,
        excitation={"reference": reference},
        controller=controller,
        noise=noise,
        seed=seed,
    )
