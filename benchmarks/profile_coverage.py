"""Coverage and speed of profile intervals at 95 %, beside those of the standard errors.

python benchmarks/profile_coverage.py [--repeats 1000] [--output FILE]

A model whose pole lies far above the band, so that the data bound it on one side alone, and the
tilt model of the paper; isotropic errors of one relative size, independent or an autoregression
from point to point. Standard errors of the first are of no use, which its column shows.

A second table has the intervals that a fit prints: profiles where it computed one unasked, those of
the standard errors elsewhere. A ladder of two resistors has the same response for R2/2 and 2 R1,
two lags for each other's time constant, and constraints choose one; a delay is near its bound.
"""

import argparse
import datetime as dt
import time
from pathlib import Path

import numpy as np

import greybox as gb
from greybox.models.rotor import Rotor
from greybox.models.tilt import Tilt


class Ladder(gb.TransferFunction):
    """Two stages of a resistor and a capacitor of one farad."""

    input, output = "u", "y"
    R1 = gb.Parameter(1.0, bounds=(0.01, 100), starts=(0.3, 5))
    R2 = gb.Parameter(1.0, bounds=(0.01, 100), starts=(0.3, 5))

    def response(self, s, p):
        """Return the response."""
        return 1 / (p.R1 * p.R2 * s**2 + (2 * p.R1 + p.R2) * s + 1)


class TwoLags(gb.TransferFunction):
    """A gain and two lags."""

    input, output = "u", "y"
    K = gb.Parameter(2.0, bounds=(0.01, 100))
    T1 = gb.Parameter(0.4, bounds=(0.001, 10))
    T2 = gb.Parameter(0.05, bounds=(0.001, 10))

    def response(self, s, p):
        """Return the response."""
        return p.K / ((p.T1 * s + 1) * (p.T2 * s + 1))


class OneSided(gb.TransferFunction):
    """A pole far above the band; the benchmark's own."""

    input, output = "u", "y"
    b = gb.Parameter(100.0, bounds=(1, 1e9), starts=(10, 1000))
    a = gb.Parameter(100.0, bounds=(1, 1e6), starts=(10, 1000))

    def response(self, s, p):
        """Return b / (s + a)."""
        return p.b / (s + p.a)


CELLS = (
    ("one-sided", OneSided(), {"b": 800.0, "a": 400.0}, np.geomspace(0.3, 30, 15), ("a",)),
    (
        "tilt",
        Tilt(),
        {"a1": -13.6, "a2": 2.77, "a3": 8.52, "a4": 294.0},
        np.geomspace(1, 40, 12),
        ("a1", "a4"),
    ),
)

LADDER, LAGS = np.geomspace(0.05, 5, 20), np.geomspace(0.5, 60, 20)
TABLE_4_2 = np.array([30.28, 20.11, 16.01, 12.03, 8.00, 5.34, 4.00, 3.50, 3.00])
PRINTED = (
    ("ladder, 2.05", Ladder(), {"R1": 1.0, "R2": 2.05}, LADDER, 0.05, ()),
    ("ladder, 2.05", Ladder(), {"R1": 1.0, "R2": 2.05}, LADDER, 0.05, (lambda p: p.R2 - 2 * p.R1,)),
    ("ladder, 4", Ladder(), {"R1": 1.0, "R2": 4.0}, LADDER, 0.05, (lambda p: p.R2 - 2 * p.R1,)),
    ("lags", TwoLags(), {"K": 2.0, "T1": 0.13, "T2": 0.1}, LAGS, 0.05, ()),
    ("lags", TwoLags(), {"K": 2.0, "T1": 0.13, "T2": 0.1}, LAGS, 0.05, (lambda p: p.T1 - p.T2,)),
    ("rotor", Rotor(), {}, TABLE_4_2, 0.05, ()),
    ("rotor", Rotor(), {}, TABLE_4_2, 0.2, ()),
)


def main() -> None:
    """Print the table, and write it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1, help="of the draws, which all cells share")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines = [
        f"greybox {gb.__version__}, {dt.date.today()}, {options.repeats} repeats of each cell, "
        f"seed {options.seed}, "
        "relative error criterion (4.26)",
        "cell       noise  correlation  parameter  profile %  Wald %  refused  s a fit with its "
        "profile",
    ]
    for name, model, truth, omega, names in CELLS:
        for errors in ((0.05, 0.0), (0.1, 0.0), (0.05, 0.3), (0.05, 0.6)):
            lines += _cell(
                name, model, truth, omega, names, errors, options.repeats, seed=options.seed
            )
            print("\n".join(lines[-len(names) :]), flush=True)
    lines += [
        "",
        "intervals that a fit prints, %: held by them / by the standard errors (profiled)",
    ]
    for case in PRINTED:
        lines.append(_printed(*case, options.repeats, seed=options.seed))
        print(lines[-1], flush=True)
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _cell(name, model, truth, omega, names, size_and_correlation, repeats, *, seed) -> list[str]:
    sigma, correlation = size_and_correlation
    values = {key: p.start for key, p in model.parameters.items()} | truth
    clean = gb.frequency_response(model, values, omega)
    profile, wald, refused = dict.fromkeys(names, 0), dict.fromkeys(names, 0), 0
    began = time.perf_counter()
    for repeat in range(repeats):
        rng = np.random.default_rng([seed, repeat])
        errors = sigma * (rng.normal(size=omega.size) + 1j * rng.normal(size=omega.size))
        for k in range(1, omega.size if correlation else 0):
            errors[k] = correlation * errors[k - 1] + np.sqrt(1 - correlation**2) * errors[k]
        data = gb.FrequencyResponse(
            omega, clean.response * (1 + errors), input=clean.input, output=clean.output
        )
        fit = gb.fit(gb.Problem(model, data), starts=3, profiles=False, progress=False)
        try:
            intervals = gb.profile(fit, names).intervals
        except ValueError:
            refused += 1
            continue
        for key in names:
            low, high = intervals[key]
            profile[key] += low <= values[key] <= high
            low, high = fit.interval()[key]
            wald[key] += low <= values[key] <= high
    seconds = (time.perf_counter() - began) / repeats
    done = max(repeats - refused, 1)
    return [
        f"{name:<10} {sigma:5.2f}  {correlation:11.1f}  {key:<9}  {100 * profile[key] / done:9.1f}"
        f"  {100 * wald[key] / done:6.1f}"
        f"  {refused:7}  {seconds:.3f}"
        for key in names
    ]


def _printed(name, model, truth, omega, sigma, constraints, repeats, *, seed) -> str:
    values = {key: p.start for key, p in model.parameters.items()} | truth
    clean = gb.frequency_response(model, values, omega)
    counts, warned, began = {}, 0, time.process_time()
    for repeat in range(repeats):
        rng = np.random.default_rng([seed, repeat])
        errors = sigma * (rng.normal(size=omega.size) + 1j * rng.normal(size=omega.size))
        data = gb.FrequencyResponse(
            omega, clean.response * (1 + errors), input=clean.input, output=clean.output
        )
        problem = gb.Problem(model, data, gb.RelativeLikelihood(), constraints=constraints)
        fit = gb.fit(problem, starts=20, seed=0, progress=False)
        wald, profiles = fit.interval(), fit.profiles.intervals if fit.profiles else {}
        warned += bool(fit.warnings)
        for key in fit.free:
            held = [
                low <= values[key] <= high
                for low, high in (profiles.get(key, wald[key]), wald[key])
            ]
            counts[key] = counts.get(key, 0) + np.array([*held, key in profiles])
    shares = (
        f"{key} {100 * a / repeats:.0f} / {100 * b / repeats:.0f} ({100 * c / repeats:.0f})"
        for key, (a, b, c) in counts.items()
    )
    what = name + (" with a constraint" if constraints else "")
    seconds = (time.process_time() - began) / repeats
    return f"{what:<32} {sigma:5.2f}  {', '.join(shares)}; warned {warned}; {seconds:.2f} s a fit"


if __name__ == "__main__":
    main()
