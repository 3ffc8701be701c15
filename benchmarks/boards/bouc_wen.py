"""Bouc-Wen, a mass on a spring with hysteresis: parameters beside the truth, and two tests.

python benchmarks/boards/bouc_wen.py [--output FILE]

The data of the benchmark (Noël and Schoukens 2016, https://www.nonlinearbenchmark.org) are
simulated, and those for estimation are left to the participant. So all are made here: by the
published equations and values, from random-phase multisines of 5 to 150 Hz and 50 N, at 15 kHz by
Runge-Kutta steps of its own, of which every twentieth is taken. The published recipe has a low-pass
filter before that; `scipy.signal.decimate(..., ftype="fir")` raises 35 Hz by 0.3 %, and the
estimates with it. One period in steady state is for estimation, with the published noise of 8e-3
mm. The tests are without noise, as published: a multisine with other phases in steady state, and a
sine sweep of 40 N from 20 to 50 Hz at 10 Hz a minute, from rest. They are not the published files,
so the published row is no strict comparison: it is the best that https://github.com/pawsen/pyvib
cites from arXiv 1610.09138, -98.32 dB in validation by a polynomial state space of 217 parameters.

The multisine reaches a fifth of the sampling rate. Straight lines between its samples bias the
estimates by many standard errors, so the input is interpolated with a band limit; both are shown.
The fit gets beta gamma and beta delta as one parameter each, since only these products matter.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from command import heading
from scipy.signal import resample_poly

import greybox as gb

RATE, FINEST, FINER = 750.0, 20, 8  # Hz, steps of the truth and of the fit in a sample
N = 8192
NOISE = 8e-6  # m
STARTS = 5
TRUTH = {"m": 2.0, "c": 10.0, "k": 5e4, "alpha": 5e4, "gamma": 800.0, "delta": -1100.0}
PUBLISHED = 1e6 * 10 ** (-98.32 / 20)  # µm


class BoucWen(gb.StateSpace):
    r"""Displacement of a mass on a spring with a hysteretic force z.

    $$m \ddot y + c \dot y + k y + z = u, \quad \dot z = \alpha \dot y - \gamma |\dot y| z - \delta
    \dot y |z|$$

    Source: Noël and Schoukens (2016), with an exponent of 1, and its beta within gamma and delta.
    """

    states, inputs, outputs = ("y", "v", "z"), ("u",), ("y",)
    units = {"u": "N", "y": "m"}
    m = gb.Parameter(1.0, bounds=(0.5, 8), unit="kg", about="mass")
    c = gb.Parameter(20.0, bounds=(0, 100), unit="N s/m", about="damping")
    k = gb.Parameter(3e4, bounds=(1e4, 2e5), unit="N/m", about="spring")
    alpha = gb.Parameter(3e4, bounds=(0, 2e5), unit="N/m", about="stiffness of the hysteresis")
    gamma = gb.Parameter(100.0, bounds=(-5e3, 5e3), unit="1/m", about="hysteresis, of |v| z")
    delta = gb.Parameter(-100.0, bounds=(-5e3, 5e3), unit="1/m", about="hysteresis, of v |z|")

    def derivative(self, x, u, p):
        """Return the rates of displacement, velocity and hysteretic force."""
        force = u.u - p.c * x.v - p.k * x.y - x.z
        hysteresis = p.gamma * abs(x.v) * x.z + p.delta * x.v * abs(x.z)
        return (x.v, force / p.m, p.alpha * x.v - hysteresis)

    def output(self, x, u, p):
        """Return the displacement."""
        return (x.y,)


def true_displacement(u: np.ndarray) -> np.ndarray:
    """Return the displacement from rest at each second one of the instants of u, at 30 kHz."""
    m, c, k, alpha, gamma, delta = TRUTH.values()
    h = 1 / (RATE * FINEST)

    def slope(y, v, z, force):
        rate = alpha * v - gamma * abs(v) * z - delta * v * abs(z)
        return v, (force - c * v - k * y - z) / m, rate

    state, result = (0.0, 0.0, 0.0), [0.0]
    force = u.tolist()
    for j in range(0, len(force) - 2, 2):
        a = slope(*state, force[j])
        b = slope(*(x + h / 2 * s for x, s in zip(state, a, strict=True)), force[j + 1])
        d = slope(*(x + h / 2 * s for x, s in zip(state, b, strict=True)), force[j + 1])
        e = slope(*(x + h * s for x, s in zip(state, d, strict=True)), force[j + 2])
        steps = zip(state, a, b, d, e, strict=True)
        state = tuple(x + h / 6 * (p + 2 * q + 2 * r + s) for x, p, q, r, s in steps)
        result.append(state[0])
    return np.array(result)


def measured(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return input and displacement at 750 Hz, of an input at 30 kHz."""
    return u[:: 2 * FINEST], true_displacement(u)[::FINEST]


def multisine(rng: np.random.Generator, periods: int) -> np.ndarray:
    """Return periods of a random-phase multisine at 30 kHz."""
    spectrum = np.zeros(N * FINEST + 1, dtype=complex)
    lines = np.arange(int(5 / RATE * N), int(np.ceil(150 / RATE * N)) + 1)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(len(lines)))
    u = np.fft.irfft(spectrum, n=2 * N * FINEST)
    return np.tile(50 * u / u.std(), periods)


def sweep() -> np.ndarray:
    """Return the sine sweep at 30 kHz."""
    time_axis = np.arange(0, 180, 1 / (2 * FINEST * RATE))
    return 40 * np.sin(2 * np.pi * (20 * time_axis + time_axis**2 / 12))


def record(u: np.ndarray, y: np.ndarray, kept: slice, finer: int) -> gb.Record:
    """Return a part, with the input at finer instants and the output where it was measured."""
    fine = resample_poly(u, finer, 1, window=("kaiser", 12.0))
    displacement = np.full(len(fine), np.nan)
    displacement[::finer] = y
    kept = slice(kept.start * finer, kept.stop * finer)
    return gb.Record(
        np.arange(kept.stop - kept.start) / (finer * RATE),
        {"u": fine[kept], "y": displacement[kept]},
        units={"u": "N", "y": "m"},
        hold={"u": 0.0, "y": 0.0},
    )


def error(values, u: np.ndarray, y: np.ndarray, scored: slice, finer: int) -> float:
    """Return the rms error in µm of a simulation from rest."""
    flown = gb.simulate(BoucWen(), values, record(u, y, slice(0, scored.stop), finer))
    residual = flown["y"][::finer][scored] - y[scored]
    return 1e6 * float(np.sqrt(np.mean(residual**2)))


def board() -> list[str]:
    """Return the lines of the table."""
    rng = np.random.default_rng(0)
    u, y = measured(multisine(rng, 4))
    y = y + rng.normal(scale=NOISE, size=len(y))
    test = {
        "multisine": (*measured(multisine(rng, 4)), slice(2 * N, 3 * N), FINER),
        "sweep": (*measured(sweep()), slice(0, int(179 * RATE)), FINER),
    }
    lines = [heading(), ""]
    errors = {
        "naive: zero": [1e6 * y[scored].std() for _, y, scored, _ in test.values()],
        "published: polynomial state space, 217": [PUBLISHED],
        "the truth": [error(TRUTH, *part) for part in test.values()],
    }
    for label, finer in {"straight lines between samples": 1, "band-limited input": FINER}.items():
        begin = time.process_time()
        problem = gb.Problem(BoucWen(), record(u, y, slice(2 * N, 3 * N), finer))
        fit = gb.fit(problem, starts=STARTS, progress=False, profiles=False)
        seconds = time.process_time() - begin
        values = {name: fit.estimate[name] for name in TRUTH}
        errors[label] = [error(values, *part) for part in test.values()]
        share = f"{fit.agreeing} of {STARTS} starts at the best minimum, {seconds:.0f} s"
        lines += [f"{label}: {share}", f"{'':6}     truth  estimate   ± standard error, off by"]
        for name, value in TRUTH.items():
            size = fit.standard_error[name]
            off = (values[name] - value) / size
            lines.append(f"{name:6}{value:10.5g}{values[name]:10.5g} ± {size:<10.2g}{off:8.1f}")
        lines.append("")

    lines.append(f"{'rms error, µm':40}" + "".join(f"{name:>12}" for name in test))
    lines += [f"{label:40}" + "".join(f"{e:12.3g}" for e in row) for label, row in errors.items()]
    return lines


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--output", type=Path)
    output = parser.parse_args().output
    text = "\n".join(board())
    print(text)
    if output:
        output.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
