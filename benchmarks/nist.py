"""NIST's 27 nonlinear regressions from their certified starts.

Digits of estimates and of standard errors, and time.

python benchmarks/nist.py [--only MGH10] [--output FILE]

Each is a static model with rows without a time, fitted by `gb.fit` from the first and from the
second of NIST's starts alone. Where one of them leads to another minimum, the table continues with
the default starts (20, seed 0), drawn between zero and that start. A digit is -log10 of the largest
relative difference to the certified values of a problem; they are given to eleven. Lanczos1 has no
meaningful certified standard errors: its residuals are the rounding of its data. Two naive rows
stand below: the starts as they are, and the mean of the data, which estimates no parameter. Source:
NIST, Statistical Reference Datasets, https://www.itl.nist.gov/div898/strd/.
"""

import argparse
import datetime as dt
import platform
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import greybox as gb

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from nist import FORMULAS, Certified, certified

RIGHT = 6.0  # digits from which an estimate is that of NIST
ROUNDING = ("Lanczos1",)


def digits(values: dict[str, float], reference: dict[str, float]) -> float:
    """Return how many digits of every value are right, at least."""
    return min(
        float(-np.log10(max(abs(values[name] / value - 1), 1e-15)))
        for name, value in reference.items()
    )


def mean_squares(case: Certified) -> float:
    """Return the sum of squares that the mean of the data leaves."""
    record, (output,) = case.problem.data, case.problem.model.outputs
    return float(len(record) * np.var(record[output]))


def line(name: str, which: str, case: Certified, **options: Any) -> tuple[str, bool]:
    """Return a line of the table, and whether the estimate is the certified one."""
    began = time.process_time()
    fit = gb.fit(case.problem, progress=False, **options)
    seconds = time.process_time() - began
    if not fit.converged:
        return f"{name:10} {which:10} {fit.status}", False
    found = digits(fit.estimate, case.values)
    errors = (
        "-"
        if name in ROUNDING or found < RIGHT
        else f"{digits(fit.standard_error, case.errors):.1f}"
    )
    estimates = f"{found:.1f}" if found >= RIGHT else "another minimum"
    numbers = f"{len(case.problem.data):4d} {len(case.values):2d}"
    agreeing = f"{fit.agreeing} of {len(fit.runs)}"
    return (
        f"{name:10} {which:10} {numbers}   {estimates:>15}   {errors:>6}   {agreeing:>8} "
        f"{seconds:7.2f}",
        found >= RIGHT,
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="NIST's nonlinear regressions")
    parser.add_argument("--only", choices=list(FORMULAS), help="one of them")
    parser.add_argument("--output", type=Path, help="write the table to this file too")
    options = parser.parse_args()

    lines: list[str] = []

    def say(text: str) -> None:
        lines.append(text)
        print(text, flush=True)

    versions = (
        f"greybox {gb.__version__}, Python {platform.python_version()}, numpy {np.__version__}"
    )
    say(f"27 problems of NIST; {versions}, {dt.datetime.now(tz=dt.UTC):%Y-%m-%d}")
    say(f"{'':10} {'from start':10} rows  p   digits: estimate   errors   agreeing       s")
    starts, means = [], []
    for name in [options.only] if options.only else list(FORMULAS):
        case = certified(name)
        starts += [digits(start, case.values) for start in case.starts]
        means.append(mean_squares(case) / case.squares)
        for k, start in enumerate(case.starts):
            text, right = line(name, str(k + 1), case, starts=[start])
            say(text)
            if not right:
                say(line(name, "1, default", case, seed=0)[0])
    say(f"naive: a start as it is has {min(starts):.1f} to {max(starts):.1f} digits")
    multiples = f"{min(means):.2g} to {max(means):.2g}, median {np.median(means):.2g}"
    say(f"naive: the mean of the data, over the certified sum of squares: {multiples}")
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
