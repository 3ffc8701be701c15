"""Coverage of bootstrap intervals at 95 %, beside that of the standard errors.

python benchmarks/bootstrap_coverage.py [--repeats 200] [--replicates 400] [--only TEXT]
    [--output FILE]

Frequency responses with isotropic errors of one relative size: a lag, the tilt model of the paper
and a pole far above the band, with few points and with more; and a lag in time whose errors are
correlated. For every cell the mean over its parameters, and the parameter that is covered the
least.
"""

import argparse
import datetime as dt
import math
import time
from pathlib import Path

import numpy as np

import greybox as gb
from greybox.models.tilt import Tilt

TILT = {"a1": -13.6, "a2": 2.77, "a3": 8.52, "a4": 294.0}


class Lag(gb.TransferFunction):
    """A gain and a lag; the benchmark's own."""

    input, output = "u", "y"
    K = gb.Parameter(1.0, bounds=(0.01, 100), starts=(0.5, 5))
    T = gb.Parameter(1.0, bounds=(0.001, 100), starts=(0.1, 1))

    def response(self, s, p):
        """Return K / (T s + 1)."""
        return p.K / (p.T * s + 1)


class OneSided(gb.TransferFunction):
    """A pole far above the band; the benchmark's own."""

    input, output = "u", "y"
    b = gb.Parameter(100.0, bounds=(1, 1e9), starts=(10, 1000))
    a = gb.Parameter(100.0, bounds=(1, 1e6), starts=(10, 1000))

    def response(self, s, p):
        """Return b / (s + a)."""
        return p.b / (s + p.a)


class LagInTime(gb.StateSpace):
    """The lag as an equation of state; the benchmark's own."""

    states, inputs, outputs = ("x",), ("u",), ("y",)
    K = gb.Parameter(1.0, bounds=(0.01, 100))
    T = gb.Parameter(1.0, bounds=(0.01, 100))

    def derivative(self, x, u, p):
        """Return (K u - x) / T."""
        return ((p.K * u.u - x.x) / p.T,)

    def output(self, x, u, p):
        """Return x."""
        return (x.x,)


RESPONSES = (
    ("lag, 5 points", Lag(), {"K": 2.0, "T": 0.3}, np.geomspace(0.5, 20, 5), 0.1),
    ("tilt, 6 points", Tilt(), TILT, np.geomspace(1, 40, 6), 0.05),
    ("tilt, 12 points", Tilt(), TILT, np.geomspace(1, 40, 12), 0.05),
    ("tilt, 24 points", Tilt(), TILT, np.geomspace(1, 40, 24), 0.05),
    ("one-sided, 15 points", OneSided(), {"b": 800.0, "a": 400.0}, np.geomspace(0.3, 30, 15), 0.05),
)
SAMPLES, RATE, CORRELATION, SIZE = (
    400,
    20,
    0.8,
    0.1,
)  # of the records: step 1/RATE s, errors of an AR(1)


def main() -> None:
    """Print the table, and write it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--replicates", type=int, default=400)
    parser.add_argument("--only", default="", help="run the cells whose name holds this text")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines = [
        f"Coverage (%) of 95 % intervals; greybox {gb.__version__}, {dt.date.today()}, "
        f"{options.repeats} repeats of "
        f"each cell, {options.replicates} replicates each",
        "relative error criterion (4.26); in time output error with errors of AR(1), see the file",
        "mean over the parameters, and the one covered the least; plain: quantiles not widened for "
        "degrees of freedom",
        f"{'cell':<22}{'plain percentile':>20}{'percentile':>20}{'Wald':>20}  failed  s each",
    ]
    print("\n".join(lines))
    cells = [(name, response_case(*case)) for name, *case in RESPONSES]
    for name, (make, truth) in [*cells, ("lag in time", _record_case())]:
        if options.only in name:
            lines.append(_line(name, make, truth, options.repeats, options.replicates))
            print(lines[-1], flush=True)
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


def response_case(model, truth, omega, sigma):
    values = {key: p.start for key, p in model.parameters.items()} | truth
    clean = gb.frequency_response(model, values, omega)

    def make(seed):
        random = np.random.default_rng(seed)
        errors = sigma * (random.normal(size=omega.size) + 1j * random.normal(size=omega.size))
        data = gb.FrequencyResponse(
            omega, clean.response * (1 + errors), input=clean.input, output=clean.output
        )
        return gb.fit(gb.Problem(model, data), starts=8, profiles=False, progress=False)

    return make, truth


def _record_case():
    truth = {"K": 2.0, "T": 0.3}
    t = np.arange(SAMPLES) / RATE
    u = np.sign(np.sin(1.3 * t) + np.sin(0.37 * t + 1))
    fade = np.exp(-1 / RATE / truth["T"])
    y = np.zeros(SAMPLES)
    for k in range(SAMPLES - 1):
        y[k + 1] = fade * y[k] + (1 - fade) * truth["K"] * u[k]

    def make(seed):
        white = (
            np.random.default_rng(seed).normal(size=SAMPLES + 100)
            * SIZE
            * np.sqrt(1 - CORRELATION**2)
        )
        errors = np.zeros(SAMPLES + 100)
        for k in range(1, SAMPLES + 100):
            errors[k] = CORRELATION * errors[k - 1] + white[k]
        record = gb.Record(t, {"u": u, "y": y + errors[100:]}, hold={"u": math.inf})
        return gb.fit(gb.Problem(LagInTime(), record), starts=[truth], progress=False)

    return make, truth


def held(make, truth, repeats, replicates):
    """Return how many intervals of every kind cover, by parameter, and failed replicates."""
    counts = {method: dict.fromkeys(truth, 0) for method in ("plain", "percentile", "wald")}
    failed = 0
    for seed in range(repeats):
        fit = make(seed)
        found = gb.bootstrap(fit, replicates, seed=seed, progress=False)
        failed += found.failed
        plain = {name: np.quantile(found[name], [0.025, 0.975]) for name in found.names}
        intervals = {"plain": plain, "percentile": found.interval()}
        intervals["wald"] = fit.interval()
        for method, by_name in intervals.items():
            for key, value in truth.items():
                low, high = by_name[key]
                counts[method][key] += low <= value <= high
    return counts, failed


def _line(name, make, truth, repeats, replicates) -> str:
    """Return the line of one cell.

    For every kind of interval the mean share that contains the truth, and the least.
    """
    began = time.perf_counter()
    counts, failed = held(make, truth, repeats, replicates)
    each = (time.perf_counter() - began) / repeats
    texts = []
    for of_method in counts.values():
        shares = {key: 100 * count / repeats for key, count in of_method.items()}
        least = min(shares, key=lambda key: shares[key])
        texts.append(f"{np.mean([*shares.values()]):.1f} ({least} {shares[least]:.1f})")
    return (
        f"{name:<22}"
        + "".join(f"{text:>20}" for text in texts)
        + f"  {100 * failed / (repeats * replicates):5.2f}%  {each:.2f}"
    )


if __name__ == "__main__":
    main()
