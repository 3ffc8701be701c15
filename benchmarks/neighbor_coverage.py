"""Coverage of 95 % intervals where errors are correlated along frequency, and its cost.

python benchmarks/neighbor_coverage.py [--repeats 400] [--only yaw] [--output FILE]

Errors are circular, of one relative size, and an autoregression of first order from point to point.
Fits and intervals are made as in `coverage.py`, and once more as if all errors were independent,
for comparison. `profile_coverage.py` has the profiles of a model that the data bound on one side
only.
"""

import argparse
import datetime as dt
import platform
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import casadi as ca
import coverage
import numpy as np
import scipy
from coverage import TRUTH, Case, Outcome, Part

import greybox as gb
from greybox.engine.compiled.response_part import ResponsePart
from greybox.models.rotor import Rotor
from greybox.models.tilt import Tilt, TiltRate

NOMINAL = (92.0, 98.0)  # per cent; outside, a number is marked
CORRELATIONS = (0.0, 0.3, 0.6, 0.8)
POINTS = (12, 24, 48, 96)
SETTINGS = (
    (0.05, "RelativeError"),
    (0.02, "RelativeError"),
    (0.2, "RelativeError"),
    (0.05, "MaximumLikelihood"),
)
FEWER = (24,)  # points, of all settings but the first


class Yaw(gb.TransferFunction):
    r"""The yaw rate (4.34) with parameters that the data determine; the benchmark's own."""

    input, output = "u", "r"
    c1 = gb.Parameter(20.0, bounds=(-20000, 20000))
    c2 = gb.Parameter(8.0, bounds=(-100, 2000))
    c3 = gb.Parameter(500.0, bounds=(1, 10000))
    c4 = gb.Parameter(1.0, bounds=(-50, 100))

    def response(self, s, p):
        """Return the response."""
        return p.c3 * (s + p.c4) / ((s + p.c4) * (s + p.c2) + p.c1) / (0.048 * s + 1)


class Rate(TiltRate):
    """The second output of the tilt model."""

    derived: dict = {}


TRUTH |= {"c1": 20.0, "c2": 8.0, "c3": 500.0, "c4": 1.0}


def cases(noise: float, n: int, correlation: float) -> Iterator[Case]:
    """Yield the models at one noise, number of points and correlation."""
    tilt = Part(Tilt(), np.geomspace(0.5, 30, n), noise, correlation=correlation)
    yield Case("tilt", (tilt,))
    yield Case("rotor", (Part(Rotor(), np.geomspace(3, 30, n), noise, correlation=correlation),))
    yield Case("yaw", (Part(Yaw(), np.geomspace(0.3, 20, n), noise, correlation=correlation),))
    yield Case("two outputs", (tilt, replace(tilt, model=Rate())))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="run the models whose name holds this text")
    parser.add_argument("--points", type=int, nargs="*", default=POINTS, help="24 among them")
    parser.add_argument(
        "--settings", type=int, default=len(SETTINGS), help="how many of the noises and criteria"
    )
    parser.add_argument("--output", type=Path, help="also write the table here")
    arguments = parser.parse_args()
    began, text, pooled = time.perf_counter(), [], {}

    def tell(line: str) -> None:
        print(line, flush=True)
        text.append(line)

    tell(
        "Coverage (%) of 95 % intervals where errors are correlated from one frequency to the next"
    )
    tell(
        f"{dt.date.today()}, greybox {gb.__version__}, casadi {ca.__version__}, numpy "
        f"{np.__version__}, "
        f"scipy {scipy.__version__}, python {platform.python_version()}; seed {arguments.seed}, "
        f"{arguments.repeats} repeats a cell"
    )
    tell(
        "covers: the least and the most of all parameters; ! outside "
        f"{NOMINAL[0]:.0f} to {NOMINAL[1]:.0f} %; independent: the same if errors are taken as "
        f"independent, as they\n"
        "were before; width: median of printed over such intervals; rough: in which share of fits "
        "it is said that so\n"
        "few points show slow errors only roughly; silent: the most that miss without that; none: "
        "without an interval."
    )
    tell(
        f"{'model':<12}{'noise':>6} "
        f"{'criterion':<18}{'points':>6}{'corr.':>6}{'covers':>16}{'independent':>14}"
        f"{'width':>7}{'rough':>7}{'silent':>8}{'none':>6}"
    )
    for noise, criterion in SETTINGS[: arguments.settings]:
        for n in arguments.points if (noise, criterion) == SETTINGS[0] else FEWER:
            for correlation in CORRELATIONS:
                for number, case in enumerate(cases(noise, n, correlation)):
                    if arguments.only not in case.label:
                        continue
                    seed = [arguments.seed, number, n]
                    found = coverage.cell(case, criterion, arguments.repeats, seed)
                    with patch.object(ResponsePart, "neighbors", lambda *_: None):
                        independent = coverage.cell(case, criterion, arguments.repeats, seed)
                    hit, line = _row(found, independent)
                    tell(
                        f"{case.label:<12}{noise:6.2f} {criterion:<18}{n:6}{correlation:6.1f}{line}"
                    )
                    pooled.setdefault((correlation, n), []).append(hit)
    tell("\nPooled, %:  points " + "".join(f"{n:8}" for n in arguments.points))
    for correlation in CORRELATIONS:
        shares = [100 * np.mean(np.concatenate(pooled[correlation, n])) for n in arguments.points]
        tell(f"  correlation {correlation:.1f}   " + "".join(f"{share:8.1f}" for share in shares))
    tell(f"\n{time.perf_counter() - began:.0f} s")
    if arguments.output:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        arguments.output.write_text("\n".join(text) + "\n", encoding="utf-8")


def _row(found: Outcome, independent: Outcome) -> tuple[np.ndarray, str]:
    """Return which intervals contain the truth, and the columns of a row."""
    hits, halves = [], []
    for outcome in (found, independent):
        half = np.array(outcome.half)
        halves.append(half)
        hits.append(np.abs(np.array(outcome.center) - outcome.truth) <= half)
    none = int(np.isnan(halves[0]).any(axis=1).sum())
    covers, before = (100 * hit.mean(axis=0) for hit in hits)
    mark = "" if NOMINAL[0] <= covers.min() and covers.max() <= NOMINAL[1] else "!"
    rough = np.array(found.rough)
    silent = 100 * (~hits[0] & ~rough[:, None]).mean(axis=0).max()
    return (
        hits[0].ravel(),
        f"{mark + f'{covers.min():.1f} - {covers.max():.1f}':>16}"
        f"{f'{before.min():.0f} - {before.max():.0f}':>14}"
        f"{np.nanmedian(halves[0] / halves[1]):7.2f}"
        f"{100 * rough.mean():6.0f}%{silent:8.1f}{none:6}",
    )


if __name__ == "__main__":
    main()
