"""Rational functions with known poles and zeros, their responses, and those that the paper
publishes."""

from pathlib import Path

import numpy as np

import greybox as gb
from greybox.regression.poles_and_zeros import Factored

TABLE = Path(__file__).parents[2] / "problems" / "data" / "table_3_1.csv"


OMEGA = np.geomspace(0.5, 20, 14)


# gain, c of the zero (s + c), time constants, quadratics (c1, c0): (3.18), (3.19), (3.20) as
# printed
ROLL = Factored(58.65, (0.304,), (), 0, (0.050, 0.193), (), ((-3.44, 13.8),))


PITCH = Factored(49.39, (-0.156,), (), 0, (0.046, 0.181), (), ((-3.79, 12.9),))


YAW = Factored(1294, (10.93,), (), 1, (0.834,), (), ((28.9, 1036),))


def table(name):
    return gb.read_response(TABLE, prefix=f"{name}_")


def expand(form):
    """Numerator and denominator of a factored form without quadratics in the numerator."""
    numerator, denominator = np.array([form.gain]), np.array([1.0] + [0.0] * form.integrators)
    for c in form.zeros:
        numerator = np.polymul(numerator, [1, c])
    for factor in [(T, 1) for T in form.time_constants] + [(1, *q) for q in form.quadratics]:
        denominator = np.polymul(denominator, factor)
    return numerator, denominator


def numbers(form):
    return np.hstack([form.gain, form.zeros, form.time_constants, *form.quadratics])


def simulated(numerator, denominator, omega=OMEGA, noise=0.0, seed=0):
    s = 1j * omega
    random = np.random.default_rng(seed)
    error = noise * (random.normal(size=len(s)) + 1j * random.normal(size=len(s))) / np.sqrt(2)
    return gb.FrequencyResponse(
        omega, np.polyval(numerator, s) / np.polyval(denominator, s) * (1 + error)
    )


ROOTS = [-1.0, -2.5, -6.0, -12.0, 0.7, 4.0, 9.0, -1.5 + 2j, -0.5 + 7j, 2 + 3j, 0.2 + 10j]


def polynomial(roots):
    return np.atleast_1d(
        np.poly(
            [r for root in roots for r in ({root, np.conj(root)} if np.imag(root) else {root})]
        ).real
    )
