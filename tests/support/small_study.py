"""A study of three structures and three data sets at operating points, where the lag is true."""

import numpy as np

import greybox as gb


class Lag(gb.TransferFunction):
    """A lag whose time constant rises with the speed."""

    K = gb.Parameter(1.0, bounds=(0.1, 10), unit="1", about="gain")
    T_lag = gb.Parameter(0.5, bounds=(0.01, 5), unit="s", about="time constant")

    def response(self, s, p):
        return p.K / (p.T_lag * s + 1)


class Gain(gb.TransferFunction):
    """A number."""

    K = gb.Parameter(1.0, bounds=(0.1, 10), unit="1")

    def response(self, s, p):
        return p.K + 0 * s


class LagLead(Lag):
    """A lag with a zero that the data do not have."""

    T_lead = gb.Parameter(0.05, bounds=(-0.5, 0.5), unit="s")

    def response(self, s, p):
        return super().response(s, p) * (p.T_lead * s + 1)


class Broken(Lag):
    """A lag that divides by zero."""

    def response(self, s, p):
        return super().response(s, p) / (p.K - p.K)


SPEEDS = {"hover": 0.0, "slow": 5.0, "fast": 10.0}  # m/s


def data(name):
    """Return the response at this operating point, with errors of 3 %."""
    omega = np.geomspace(0.5, 20, 12)
    rng = np.random.default_rng(len(name) + round(SPEEDS[name]))
    errors = 0.03 * (rng.standard_normal(12) + 1j * rng.standard_normal(12)) / np.sqrt(2)
    response = 2.0 / ((0.2 + 0.03 * SPEEDS[name]) * 1j * omega + 1) * (1 + errors)
    return gb.FrequencyResponse(omega, response, "u", "y", name=name)


def members():
    """Return all structures with all data, one of them twice, and a model that fails."""
    structures = (Lag, Gain, LagLead)
    fits = [
        gb.study.Member(gb.Problem(model(), data(name)), starts=3, name=f"{name}, {model.__name__}")
        for name in SPEEDS
        for model in structures
    ]
    again = gb.study.Member(gb.Problem(Lag(), data("fast")), starts=3, seed=1, name="fast again")
    broken = gb.study.Member(gb.Problem(Broken(), data("slow")), starts=1, name="broken")
    return [*fits, again, broken]
