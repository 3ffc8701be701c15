"""Silverbox, an electronic Duffing oscillator: a mass, a damper and a cubic spring.

python benchmarks/boards/silverbox.py FOLDER [--output FILE]

FOLDER has `SNLS80mV.csv` of the benchmark of https://www.nonlinearbenchmark.org (Wigren and
Schoukens 2013): input and output voltage, 131 072 samples at 610.35 Hz.

The parts are those of the official loader, `nonlinear_benchmarks`: three quarters of the multisines
for estimation; for the test the other quarter, and noise whose amplitude grows, beyond that of the
estimation near the end ("arrow"). The error is the rms error of a free simulation after the first
50 samples of a test; these alone may be used for the initial state.

The circuit sees a smooth voltage with contents up to a third of the sampling rate. Straight lines
between its samples are too coarse for that, so the input is interpolated with a band limit.

Structures are compared by cross-validation: one half of the estimation data predicts the other.
The one with the least error is fitted to all of it and run on the tests, once.

The published rows are those of the README of https://github.com/merijnfloren/freq-statespace, on
six periods of the data for estimation; its models have two states, too.
"""

import time
from pathlib import Path

import numpy as np
from command import estimates, heading, judged, parser, show
from scipy.signal import resample_poly

import greybox as gb

RATE = 610.35  # Hz
LOOK = 50  # samples for the initial state
STARTS = 5
ESTIMATION = (40650, 105712)
HALVES = ((40650, 73181), (73181, 105712))
TESTS = {"multisine": (105712, 127400), "arrow": (100, 40575), "its begin": (100, 32100)}
PUBLISHED = {
    "published: linear state space": 13.17,
    "published: linear with a cubic feedback": 0.44,
}


class Duffing(gb.StateSpace):
    r"""Displacement of a mass on a hardening spring.

    $$\ddot x + (d + d_3 x^2) \dot x + k_1 x + k_3 x^3 + k_5 x^5 = b (u - u_0), \quad y = x + y_0$$

    Source: Wigren and Schoukens (2013), with two terms more of the same symmetry.
    """

    states, inputs, outputs = ("x", "v"), ("u",), ("y",)
    units = {"u": "V", "y": "V"}
    b = gb.Parameter(1e5, bounds=(1e4, 1e6), unit="1/s²", about="gain")
    d = gb.Parameter(20.0, bounds=(0, 200), unit="1/s", about="damping")
    k_1 = gb.Parameter(1e5, bounds=(1e4, 1e6), unit="1/s²", about="spring")
    k_3 = gb.Parameter(0.0, bounds=(-1e7, 1e7), unit="1/(s² V²)", about="cubic spring")
    k_5 = gb.Parameter(0.0, bounds=(-1e8, 1e8), unit="1/(s² V⁴)", about="quintic spring")
    d_3 = gb.Parameter(0.0, bounds=(-1e4, 1e4), unit="1/(s V²)", about="damping by amplitude")
    u_0 = gb.Parameter(0.0, bounds=(-0.1, 0.1), unit="V", about="offset of the input")
    y_0 = gb.Parameter(0.0, bounds=(-0.1, 0.1), unit="V", about="offset of the output")

    def derivative(self, x, u, p):
        """Return velocity and acceleration."""
        spring = (p.k_1 + p.k_3 * x.x**2 + p.k_5 * x.x**4) * x.x
        return (x.v, p.b * (u.u - p.u_0) - (p.d + p.d_3 * x.x**2) * x.v - spring)

    def output(self, x, u, p):
        """Return the measured voltage."""
        return (x.x + p.y_0,)


LINEAR = {"k_3": 0.0, "k_5": 0.0, "d_3": 0.0}
STRUCTURES = {  # what is zero, and instants of the input for one of the output
    "linear": (LINEAR, 8),
    "cubic spring, straight lines between samples": ({"k_5": 0.0, "d_3": 0.0}, 1),
    "cubic spring": ({"k_5": 0.0, "d_3": 0.0}, 8),
    "cubic and quintic spring": ({"d_3": 0.0}, 8),
    "cubic spring, damping by amplitude": ({"k_5": 0.0}, 8),
    "cubic and quintic spring, damping by amplitude": ({}, 8),
}


def record(table: np.ndarray, begin: int, end: int, finer: int) -> gb.Record:
    """Return a part, with the input at finer instants and the output where it was measured."""
    first = max(begin - 200, 0)  # the filter of the interpolation needs neighbors
    u = resample_poly(table[first : end + 200, 0], finer, 1, window=("kaiser", 12.0))
    y = np.full(finer * (end - begin), np.nan)
    y[::finer] = table[begin:end, 1]
    return gb.Record(
        np.arange(len(y)) / (finer * RATE),
        {"u": u[finer * (begin - first) :][: len(y)], "y": y},
        units={"u": "V", "y": "V"},
        hold={"u": 0.0, "y": 0.0},
    )


def fitted(table: np.ndarray, part: tuple[int, int], label: str) -> gb.Fit:
    """Fit a structure to a part."""
    held, finer = STRUCTURES[label]
    problem = gb.Problem(Duffing(), record(table, *part, finer), fixed=held)
    return gb.fit(problem, starts=STARTS, progress=False, profiles=False)


def error(fit: gb.Fit, table: np.ndarray, part: tuple[int, int], label: str) -> float:
    """Return the rms error in mV of a free simulation from the state that the look gives."""
    times = {"lead": LOOK / RATE, "horizon": (part[1] - part[0] - LOOK) / RATE}
    flown = gb.predict(fit, record=record(table, *part, STRUCTURES[label][1]), own=(), **times)
    return 1e3 * flown.rms("y")


def board(folder: Path) -> list[str]:
    """Return the lines of the table."""
    with (folder / "SNLS80mV.csv").open(encoding="utf-8") as file:
        table = np.genfromtxt(file, delimiter=",", skip_header=1, usecols=(0, 1))
    lines = [heading(), "", f"{'each half of the estimation from the other':50}error, mV  seconds"]
    errors = {}
    for label in STRUCTURES:
        begin = time.process_time()
        folds = zip(HALVES, HALVES[::-1], strict=True)
        squares = [error(fitted(table, a, label), table, b, label) ** 2 for a, b in folds]
        errors[label] = float(np.sqrt(np.mean(squares)))
        lines.append(f"{label:50}{errors[label]:9.3f}{time.process_time() - begin:9.0f}")

    best = min(errors, key=lambda label: errors[label])
    begin = time.process_time()
    fit = fitted(table, ESTIMATION, best)
    seconds = time.process_time() - begin
    linear = fitted(table, ESTIMATION, "linear")
    lines += ["", f"{'rms error, mV':50}" + "".join(f"{name:>12}" for name in TESTS)]
    measured = [table[begin + LOOK : end, 1] for begin, end in TESTS.values()]
    mean = table[slice(*ESTIMATION), 1].mean()
    rows = {
        "naive: mean level": [1e3 * np.sqrt(np.mean((y - mean) ** 2)) for y in measured],
        "linear": [error(linear, table, part, "linear") for part in TESTS.values()],
        "chosen: " + best: [error(fit, table, part, best) for part in TESTS.values()],
    }
    lines += [f"{label:50}" + "".join(f"{e:12.3f}" for e in row) for label, row in rows.items()]

    share = 100 * error(fit, table, ESTIMATION, best) / (1e3 * table[slice(*ESTIMATION), 1].std())
    lines += [
        "",
        "on the data for estimation, error over standard deviation",
        *(f"{label:50}{value:9.2f} %" for label, value in PUBLISHED.items()),
        f"{'chosen':50}{share:9.2f} %",
        "",
        f"starts at the best minimum: {fit.agreeing} of {STARTS}, {seconds:.0f} s",
    ]
    return [
        *lines,
        *estimates(fit, Duffing().parameters),
        "",
        *judged("linear", linear),
        *judged("chosen", fit),
    ]


if __name__ == "__main__":
    show(board, parser(__doc__).parse_args())
