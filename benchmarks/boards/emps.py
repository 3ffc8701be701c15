"""EMPS: a drive with a ball screw and friction, from its motor force to its position.

python benchmarks/boards/emps.py FOLDER [--output FILE]

FOLDER has `nlid_emps_sim_data_training.mat` of https://github.com/meco-group/nlgreyfast, which
holds the record for estimation of the benchmark of https://www.nonlinearbenchmark.org (Janot,
Gautier and Brunot 2019), 24.84 s at 1 kHz. The record for validation, `DATA_EMPS_PULSES.mat`, was
not at hand: the first half is fitted and the second one is the test, so that no number here
compares with those of the benchmark. The published estimates saw both halves.

The plant is an integrator: an error of force grows without limit. Each half is simulated freely
over its 12.4 s, at 250 Hz, from its first position and a velocity of three samples.
"""

import time
from pathlib import Path

import numpy as np
from command import heading, judged, parser, show
from scipy.io import loadmat

import greybox as gb

STARTS = 4
SAMPLES, THINNING = 12420, 4  # of each half; every fourth is used
PUBLISHED = {"M": 95.1089, "F_v": 203.5034, "F_c": 20.3935, "offset": -3.1648}  # nlid_emps_init.m


class Drive(gb.StateSpace):
    r"""A mass with viscous and Coulomb friction, $M \ddot x = f - F_v v - F_c s(v) - o$."""

    states, inputs, outputs = ("x", "v"), ("force",), ("x",)
    M = gb.Parameter(100.0, bounds=(1, 1000), unit="kg", about="mass")
    F_v = gb.Parameter(200.0, bounds=(0, 5000), unit="N s/m", about="viscous friction")
    F_c = gb.Parameter(20.0, bounds=(0, 500), unit="N", about="Coulomb friction")
    offset = gb.Parameter(0.0, bounds=(-100, 100), unit="N", about="offset of the force")

    def derivative(self, x, u, p):
        """Return the rates; the sign of v is smooth within 0.5 mm/s."""
        friction = p.F_v * x.v + p.F_c * gb.tanh(x.v / 5e-4) + p.offset
        return (x.v, (u.force - friction) / p.M)

    def output(self, x, u, p):
        """Return the position."""
        return (x.x,)


class Accelerations(gb.StateSpace):
    """The same mass with the coefficients per mass, which enter linearly."""

    states, inputs, outputs = Drive.states, Drive.inputs, Drive.outputs
    per_mass = gb.Parameter(0.01, bounds=(1e-3, 1), unit="1/kg")
    F_v = gb.Parameter(2.0, bounds=(0, 5000), unit="1/s")
    F_c = gb.Parameter(0.2, bounds=(0, 500), unit="m/s²")
    offset = gb.Parameter(0.0, bounds=(-100, 100), unit="m/s²")

    def derivative(self, x, u, p):
        """Return the rates."""
        return (x.v, p.per_mass * u.force - p.F_v * x.v - p.F_c * gb.tanh(x.v / 5e-4) - p.offset)

    def output(self, x, u, p):
        """Return the position."""
        return (x.x,)


def by_equation_error(record: gb.Record) -> dict[str, float]:
    """Return the parameters of the drive by equation error."""
    per_mass = dict(gb.regression.equation_error(Accelerations(), record).estimate)
    M = 1 / per_mass.pop("per_mass")
    return {"M": M} | {name: M * value for name, value in per_mass.items()}


def half(folder: Path, k: int) -> gb.Record:
    """Return a half of the record."""
    data = loadmat(folder / "nlid_emps_sim_data_training.mat")
    rows = slice(k * SAMPLES, (k + 1) * SAMPLES, THINNING)
    signals = {"x": data["qm"][rows, 0], "force": data["gtau"][0, 0] * data["vir"][rows, 0]}
    axis = 1e-3 * THINNING * np.arange(len(signals["x"]))
    return gb.Record(axis, signals, hold={"x": 0.0, "force": 0.0}, name=f"half {k + 1}")


def error(values: dict[str, float], record: gb.Record) -> float:
    """Return the rms error of a free simulation, mm."""
    x, step = record["x"], record.time[1]
    initial = {"x": float(x[0]), "v": float((4 * x[1] - 3 * x[0] - x[2]) / (2 * step))}
    simulated = gb.simulate(Drive(), values, record, initial=initial)
    return 1e3 * float(np.sqrt(np.mean((simulated["x"] - x) ** 2)))


def board(folder: Path) -> list[str]:
    """Return the lines of the table."""
    first, second = half(folder, 0), half(folder, 1)
    guess = by_equation_error(first)
    begin = time.process_time()
    fit = gb.fit(gb.Problem(Drive(), first), STARTS, progress=False, profiles=False)
    spent = time.process_time() - begin
    smooth = gb.Problem(Drive(), first, fixed={"F_c": 0.0})
    without = gb.fit(smooth, STARTS, progress=False, profiles=False)
    lines = [heading(), "", f"{'':8}{'published':>10}{'equation error':>16}{'output error':>20}"]
    for name, value in PUBLISHED.items():
        cell = f"{fit.estimate[name]:.4g} ± {fit.standard_error[name]:.2g}"
        lines.append(f"{name:8}{value:10.4g}{guess[name]:16.4g}{cell:>20}")
    errors = {"published": PUBLISHED, "equation error": guess, "output error": fit.estimate}
    mean = 1e3 * float(np.sqrt(np.mean((second["x"] - first["x"].mean()) ** 2)))
    return [
        *lines,
        f"{fit.agreeing} of {STARTS} starts at the best minimum, {spent:.0f} s",
        f"{'error on the second half, mm: mean of the first':50}{mean:8.2f}",
        *(f"{name:50}{error(values, second):8.2f}" for name, values in errors.items()),
        "",
        *judged("output error", fit),
        *judged("without Coulomb friction", without),
    ]


if __name__ == "__main__":
    show(board, parser(__doc__).parse_args())
