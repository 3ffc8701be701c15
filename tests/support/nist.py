"""NIST's nonlinear regression problems.

Static models, rows without a time, starts and certified values.

Source: NIST, Statistical Reference Datasets, https://www.itl.nist.gov/div898/strd/ (public domain).
"""

import math
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

import greybox as gb

FOLDER = Path(__file__).parents[1] / "data" / "nist"


def _gauss(p, x):
    bell = p.b3 * gb.exp(-(((x - p.b4) / p.b5) ** 2)) + p.b6 * gb.exp(-(((x - p.b7) / p.b8) ** 2))
    return p.b1 * gb.exp(-p.b2 * x) + bell


def _lanczos(p, x):
    return p.b1 * gb.exp(-p.b2 * x) + p.b3 * gb.exp(-p.b4 * x) + p.b5 * gb.exp(-p.b6 * x)


def _cubic_ratio(p, x):
    return (p.b1 + x * (p.b2 + x * (p.b3 + x * p.b4))) / (1 + x * (p.b5 + x * (p.b6 + x * p.b7)))


def _enso(p, x):
    def wave(a, b, period):
        return a * gb.cos(2 * math.pi * x / period) + b * gb.sin(2 * math.pi * x / period)

    return p.b1 + wave(p.b2, p.b3, 12) + wave(p.b5, p.b6, p.b4) + wave(p.b8, p.b9, p.b7)


FORMULAS = {
    "Bennett5": lambda p, x: p.b1 * (p.b2 + x) ** (-1 / p.b3),
    "BoxBOD": lambda p, x: p.b1 * (1 - gb.exp(-p.b2 * x)),
    "Chwirut1": lambda p, x: gb.exp(-p.b1 * x) / (p.b2 + p.b3 * x),
    "Chwirut2": lambda p, x: gb.exp(-p.b1 * x) / (p.b2 + p.b3 * x),
    "DanWood": lambda p, x: p.b1 * x**p.b2,
    "ENSO": _enso,
    "Eckerle4": lambda p, x: p.b1 / p.b2 * gb.exp(-0.5 * ((x - p.b3) / p.b2) ** 2),
    "Gauss1": _gauss,
    "Gauss2": _gauss,
    "Gauss3": _gauss,
    "Hahn1": _cubic_ratio,
    "Kirby2": lambda p, x: (p.b1 + x * (p.b2 + x * p.b3)) / (1 + x * (p.b4 + x * p.b5)),
    "Lanczos1": _lanczos,
    "Lanczos2": _lanczos,
    "Lanczos3": _lanczos,
    "MGH09": lambda p, x: p.b1 * (x**2 + x * p.b2) / (x**2 + x * p.b3 + p.b4),
    "MGH10": lambda p, x: p.b1 * gb.exp(p.b2 / (x + p.b3)),
    "MGH17": lambda p, x: p.b1 + p.b2 * gb.exp(-x * p.b4) + p.b3 * gb.exp(-x * p.b5),
    "Misra1a": lambda p, x: p.b1 * (1 - gb.exp(-p.b2 * x)),
    "Misra1b": lambda p, x: p.b1 * (1 - (1 + p.b2 * x / 2) ** -2),
    "Misra1c": lambda p, x: p.b1 * (1 - (1 + 2 * p.b2 * x) ** -0.5),
    "Misra1d": lambda p, x: p.b1 * p.b2 * x / (1 + p.b2 * x),
    "Nelson": lambda p, x, t: p.b1 - p.b2 * x * gb.exp(-p.b3 * t),
    "Rat42": lambda p, x: p.b1 / (1 + gb.exp(p.b2 - p.b3 * x)),
    "Rat43": lambda p, x: p.b1 / (1 + gb.exp(p.b2 - p.b3 * x)) ** (1 / p.b4),
    "Roszman1": lambda p, x: p.b1 - p.b2 * x - gb.arctan(p.b3 / (x - p.b4)) / math.pi,
    "Thurber": _cubic_ratio,
}


@dataclass(frozen=True, eq=False)
class Certified:
    """One problem: two starts, certified values and standard deviations by name, and data."""

    problem: gb.Problem
    starts: tuple[dict[str, float], dict[str, float]]
    values: dict[str, float]
    errors: dict[str, float]
    squares: float


@cache
def certified(name):
    """Read one of the files."""
    lines = (FOLDER / f"{name}.dat").read_text(encoding="ascii").splitlines()
    rows = [line.split() for line in lines if re.match(r"\s+b\d+ =", line)]
    table = {row[0]: [float(value) for value in row[2:6]] for row in rows}
    squares = next(
        float(line.split()[-1]) for line in lines if line.startswith("Residual Sum of Squares")
    )
    data = np.array(
        [[float(value) for value in line.split()] for line in lines[60:] if line.strip()]
    ).T
    y, inputs = data[0], data[1:]
    if name == "Nelson":
        y = np.log(y)
    signals = dict(zip(("x", "t"), inputs, strict=False))

    formula = FORMULAS[name]
    body = {
        "states": (),
        "inputs": tuple(signals),
        "outputs": ("y",),
        "output": lambda self, x, u, p: (formula(p, *(u[key] for key in signals)),),
        # Default starts are drawn between zero and the first of theirs.
        **{
            key: gb.Parameter(start, starts=(min(start, 0), max(start, 0)))
            for key, (start, *_) in table.items()
        },
    }
    model = type(name, (gb.StateSpace,), body)
    record = gb.Record(None, {**signals, "y": y}, name=name)
    starts = tuple({key: values[k] for key, values in table.items()} for k in (0, 1))
    return Certified(
        gb.Problem(model(), record),
        starts,
        {key: values[2] for key, values in table.items()},
        {key: values[3] for key, values in table.items()},
        squares,
    )
