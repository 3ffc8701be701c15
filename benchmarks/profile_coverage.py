"""Coverage and speed of profile intervals at 95 %, beside those of the standard errors.

python benchmarks/profile_coverage.py [--repeats 1000] [--output FILE]

A model whose pole lies far above the band, so that the data bound it on one side alone, and the
tilt model of the paper; isotropic errors of one relative size, independent or an autoregression
from point to point. Standard errors of the first are of no use, which its column shows.
"""

import argparse
import datetime as dt
import time
from pathlib import Path

import numpy as np

import greybox as gb
from greybox.models.tilt import Tilt


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


if __name__ == "__main__":
    main()
