"""Synthetic data with a known truth, and the models that several test files fit to them."""

import numpy as np

import greybox as gb


class LagLagDelay(gb.TransferFunction):
    r"""Two lags and a delay, $K e^{-s \tau} / ((T_1 s + 1)(T_2 s + 1))$: the lags may swap."""

    K = gb.Parameter(1.0, bounds=(0, 100), about="gain")
    T1 = gb.Parameter(0.1, bounds=(0.001, 10), unit="s", about="first lag")
    T2 = gb.Parameter(0.1, bounds=(0.001, 10), unit="s", about="second lag")
    tau = gb.Parameter(0.01, bounds=(0, 0.5), unit="s", about="delay")

    def response(self, s, p):
        return p.K / ((p.T1 * s + 1) * (p.T2 * s + 1)) * gb.exp(-s * p.tau)


class Lag(gb.TransferFunction):
    """A gain and one lag, both over decades."""

    K = gb.Parameter(1.0, bounds=(1e-3, 1e3), unit="m", about="gain", scale="log")
    T = gb.Parameter(1.0, bounds=(1e-4, 1e4), unit="s", about="time constant", scale="log")
    derived = {"bandwidth": lambda p: 1 / p.T, "area": lambda p: p.K * p.T**2}

    def response(self, s, p):
        return p.K / (p.T * s + 1)


class Oscillator(gb.TransferFunction):
    """Undamped: its pole lies on the imaginary axis, at w0."""

    w0 = gb.Parameter(2.0, bounds=(0.1, 10), unit="rad/s")
    K = gb.Parameter(1.0, bounds=(0.1, 100))

    def response(self, s, p):
        return p.K / (s**2 + p.w0**2)


class Parabola(gb.TransferFunction):
    """The gain is (x² - 1)² + slope · x + 2.

    Two minima near x = ±1 when a gain of 2 is measured.
    """

    x = gb.Parameter(0.3, bounds=(-2, 2))
    slope = gb.Parameter(0.1, fixed=True)

    def response(self, s, p):
        return ((p.x**2 - 1) ** 2 + p.slope * (1 - p.x) + 2) / (s + 1)


TWO_LAGS = {"K": 5.0, "T1": 1.0, "T2": 0.1, "tau": 0.05}
TWO_LAGS_OMEGA = np.geomspace(0.1, 30, 30)
TILT = {"a1": -2.0, "a2": 4.0, "a3": 3.0, "a4": 200.0}
TILT_OMEGA = np.geomspace(2, 30, 16)
ROTOR = {"K_Omega": 1200.0, "T_rotor": 0.06, "T_delay": 0.008}
ROTOR_OMEGA = np.geomspace(2, 60, 12)


def measured(model, omega, values=None, noise=0.0, seed=0, name="made", columns=None, **options):
    """The model's own response with isotropic errors, `noise` in each component relative to the
    magnitude."""
    exact = gb.frequency_response(model, values, omega, **options)
    random = np.random.default_rng(seed)
    error = noise * (random.normal(size=len(exact)) + 1j * random.normal(size=len(exact)))
    return gb.FrequencyResponse(
        exact.omega,
        exact.response * (1 + error),
        input=exact.input,
        output=exact.output,
        name=name,
        about=exact.about,
        **(columns or {}),
    )


class Integrator(gb.TransferFunction):
    """1/s behind the rotor."""

    input, output = "Omega", "angle"

    def response(self, s, p):
        return 1 / s
