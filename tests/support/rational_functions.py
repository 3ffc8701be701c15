"""Rational functions with known poles and zeros, their responses, and those that the paper
publishes."""

import re
from pathlib import Path

import numpy as np

import greybox as gb

TABLE = Path(__file__).parents[2] / "problems" / "data" / "table_3_1.csv"


OMEGA = np.geomspace(0.5, 20, 14)


# (3.18), (3.19), (3.20) as printed
ROLL = "58.65 (s + 0.304) / [(0.05 s + 1) (0.193 s + 1) (s² - 3.44 s + 13.8)]"
PITCH = "49.39 (s - 0.156) / [(0.046 s + 1) (0.181 s + 1) (s² - 3.79 s + 12.9)]"
YAW = "1294 (s + 10.93) / [s (0.834 s + 1) (s² + 28.9 s + 1036)]"


def table(name):
    return gb.read_response(TABLE, prefix=f"{name}_")


def evaluated(form, s):
    """The values of a factored form at s."""
    text = re.sub(r"(?<=[\d)s²]) (?=[(\ds\[])", " * ", form.replace(" / [", " / ("))
    text = text.replace("]", ")").replace("²", "**2")
    return eval(text, {"s": s})


def numbers(form):
    """The numbers of a factored form, without the ones of lags."""
    words = re.findall(r"[-+]? ?\d[\d.e-]*", form.replace(" s + 1)", ")"))
    return np.array([float(word.replace(" ", "")) for word in words])


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
