"""Coverage of flights that no fit has seen, by simulations with draws of parameters.

python benchmarks/draws_coverage.py [--repeats 200] [--output FILE]

In every repeat a model is fitted to a noisy test, `gb.draws` gives 200 parameter sets, and a
simulator of the benchmark's own runs each of them through a flight with other inputs. The 95 % band
of these motions at every sample is held against the true motion; with the estimated noise of the
sensor added, against the measured one.
"""

import argparse
import datetime as dt
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.linalg import expm

import greybox as gb

DRAWS = 200
STEP = 0.02  # s


class Cart(gb.StateSpace):
    """A cart on a rail with friction and drag."""

    states, inputs, outputs = ("x", "v"), ("F",), ("v",)
    m = gb.Parameter(1.0, bounds=(0.1, 10))
    b = gb.Parameter(1.0, bounds=(0, 20))
    c = gb.Parameter(0.1, bounds=(0, 5))

    def derivative(self, x, u, p):
        """Return velocity and acceleration."""
        return x.v, (u.F - p.b * x.v - p.c * abs(x.v) * x.v) / p.m

    def output(self, x, u, p):
        """Return the velocity."""
        return (x.v,)


class Rate(gb.StateSpace):
    """The rate of a multirotor: gain, damping, rotors."""

    states, inputs, outputs = ("v", "M"), ("F",), ("v",)
    K = gb.Parameter(30.0, bounds=(1, 1e3))
    a = gb.Parameter(1.0, bounds=(0, 100))
    T = gb.Parameter(0.03, bounds=(0.001, 1))

    def derivative(self, x, u, p):
        """Return the derivatives of K / ((s + a) (T s + 1))."""
        return p.K * x.M - p.a * x.v, (u.F - x.M) / p.T

    def output(self, x, u, p):
        """Return the rate."""
        return (x.v,)


class FarPole(gb.StateSpace):
    """A lag above the band, which the data bound on one side alone."""

    states, inputs, outputs = ("v",), ("F",), ("v",)
    k = gb.Parameter(1.0, bounds=(0.01, 100))
    T = gb.Parameter(0.01, bounds=(1e-4, 1))

    def derivative(self, x, u, p):
        """Return the derivative of k / (T s + 1)."""
        return ((p.k * u.F - x.v) / p.T,)

    def output(self, x, u, p):
        """Return the output of the lag."""
        return (x.v,)


def main() -> None:
    """Print the table, and write it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines = [
        f"greybox {gb.__version__}, {dt.date.today()}, {options.repeats} repeats, {DRAWS} draws",
        "± is the standard error over the repeats; samples within the 95 % band",
        "",
        "fit of                                   true motion %   measured %",
    ]
    omega = np.geomspace(0.5, 20, 14)
    cart, rate = {"m": 2.0, "b": 1.5, "c": 0.8}, {"K": 60.0, "a": 2.0, "T": 0.05}
    cells = (
        ("cart, 8 s, noise 0.05", Cart(), cart, 0.05, None),
        ("cart, 8 s, noise 0.3", Cart(), cart, 0.3, None),
        (
            "rate, response of 14 points, noise 5 %",
            Rate(),
            rate,
            0.05,
            omega,
        ),
        (
            "rate, response of 14 points, noise 15 %",
            Rate(),
            rate,
            0.15,
            omega,
        ),
        ("pole above the band, noise 5 %", FarPole(), {"k": 2.0, "T": 0.015}, 0.05, omega),
    )
    for name, model, truth, noise, grid in cells:
        shares = [_repeat(model, truth, noise, grid, seed) for seed in range(options.repeats)]
        texts = [
            "-"
            if np.isnan(column).all()
            else f"{100 * column.mean():.1f} ± {100 * column.std() / len(column) ** 0.5:.1f}"
            for column in np.array(shares).T
        ]
        lines.append(f"{name:<39}  {texts[0]:>13}  {texts[1]:>11}")
        print(lines[-1], flush=True)
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _drive(seed):
    """Return a force that changes every half second."""
    time = np.arange(0, 8, STEP)
    levels = np.random.default_rng(seed).uniform(-6, 6, 16)
    return gb.Record(time, {"F": np.repeat(levels, 25)}, hold={"F": np.inf})


def _motion(model, columns, drive):
    """Return the outputs (n, samples) of n parameter sets, given as columns (n,)."""
    p = SimpleNamespace(**{name: np.asarray(column) for name, column in columns.items()})
    count = len(p.__dict__[next(iter(columns))])

    def slope(x, u):
        states = SimpleNamespace(**dict(zip(model.states, x, strict=True)))
        return np.array(np.broadcast_arrays(*model.derivative(states, SimpleNamespace(F=u), p)))

    size = len(model.states)
    x = np.zeros((size, count))
    motion = np.empty((count, len(drive)))
    if not isinstance(model, Cart):
        # Linear: exact steps, however fast a pole is.
        unit = np.eye(size + 1)[:, :, None] * np.ones(count)
        rows = [slope(unit[:size, k], unit[size, k]) for k in range(size + 1)]
        augmented = np.zeros((count, size + 1, size + 1))
        augmented[:, :size] = np.moveaxis(rows, 2, 0).swapaxes(1, 2)
        steps = expm(STEP * augmented)[:, :size]
    for k, force in enumerate(drive["F"]):
        motion[:, k] = x[model.states.index("v")]
        if isinstance(model, Cart):
            k1 = slope(x, force)
            k2 = slope(x + STEP / 2 * k1, force)
            k3 = slope(x + STEP / 2 * k2, force)
            x = x + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + slope(x + STEP * k3, force))
        else:
            held = np.vstack([x, np.full((1, count), force)])
            x = np.einsum("nij,jn->in", steps, held)
    return motion


def _flown(model, truth, drive, noise, rng):
    """Return the true output and the measured one."""
    (true,) = _motion(model, {name: [value] for name, value in truth.items()}, drive)
    return true, true + noise * rng.standard_normal(true.size)


def _repeat(model, truth, noise, grid, seed):
    """Return the shares of samples of a held-out flight within the bands."""
    rng = np.random.default_rng([seed, 1])
    if grid is None:
        drive = _drive([seed, 2])
        signals = {"F": drive["F"], "v": _flown(model, truth, drive, noise, rng)[1]}
        data = gb.Record(drive.time, signals, hold={"F": np.inf, "v": 0.0})
    else:
        clean = gb.frequency_response(model, truth, grid)
        errors = noise * (rng.normal(size=grid.size) + 1j * rng.normal(size=grid.size))
        data = gb.FrequencyResponse(grid, clean.response * (1 + errors), "F", "v")
        data = data.with_independent_errors()
    fit = gb.fit(gb.Problem(model, data), starts=4, progress=False)
    draws = gb.draws(fit, DRAWS, seed)

    drive = _drive([seed, 3])
    true, measured = _flown(model, truth, drive, noise, rng)
    motions = _motion(model, {name: draws.columns[name] for name in truth}, drive)
    of_truth = _share(motions, true)
    if grid is not None:
        return of_truth, np.nan
    sensor = float(np.sqrt(fit.records[0].noise[0, 0]))
    return of_truth, _share(motions + sensor * rng.standard_normal(motions.shape), measured)


def _share(motions, flown):
    low, high = np.quantile(motions, (0.025, 0.975), axis=0)
    # At the beginning all motions are zero.
    moves = high > low
    return np.mean(((low <= flown) & (flown <= high))[moves])


if __name__ == "__main__":
    main()
