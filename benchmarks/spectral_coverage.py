"""From a sweep to an interval.

How often do 95 % intervals of maximum likelihood hold? Monte Carlo on known systems.

python benchmarks/spectral_coverage.py [--repeats 200] [--only example] [--output FILE]

Records with noise, their spectral estimate with its defaults, and a fit of all parameters by
maximum likelihood from the truth. To be quick the fit is one of scipy with the same cost and the
same standard errors (`tests/support/known_systems.py`); the first records of the example are fitted
by `gb.fit` too, and the table says how far the standard errors differ if errors of different
frequencies are independent. Without this statement, `gb.fit` asks the residuals and allows for a
correlation where they show one: the factor on the standard errors is the last column.

Printed: points and degrees of freedom of their variances; the squared error of a point over its
variance; per parameter the share of intervals that contain the truth, and the root mean square of
the error over the standard error.
"""

import argparse
import datetime as dt
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import greybox as gb
from greybox.data.spectral import spectral_response

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from known_systems import EXAMPLE, LAG, LIGHT, MODE, NOTCH, System, flown, maximum_likelihood

CHECKS = 2  # number of records of the example that are fitted by gb.fit, too

CELLS: dict[str, tuple[System, str, dict[str, float]]] = {
    "example, logarithmic sweep": (EXAMPLE, "logarithmic", {}),
    "example, sweep of CIFER": (EXAMPLE, "cifer", {}),
    "example, noise 0.05 to 1.5 Hz": (EXAMPLE, "noise", {}),
    "example, linear sweep": (EXAMPLE, "linear", {}),
    "example, logarithmic sweep, noise 1 %": (EXAMPLE, "logarithmic", {"noise": 0.01}),
    "example, logarithmic sweep, noise AR(0.95)": (EXAMPLE, "logarithmic", {"pole": 0.95}),
    "example, noise, 400 s, 20 Hz, noise 30 %": (
        EXAMPLE,
        "noise",
        {"duration": 400.0, "rate": 20.0, "noise": 0.3},
    ),
    "lag, sweep of CIFER, 60 s": (LAG, "cifer", {"duration": 60.0}),
    "notch, linear sweep, 90 s, 50 Hz": (NOTCH, "linear", {"duration": 90.0, "rate": 50.0}),
    "mode damped by 0.08, sweep of CIFER": (MODE, "cifer", {}),
    "mode damped by 0.08, noise": (MODE, "noise", {}),
    "mode damped by 0.03, logarithmic sweep": (LIGHT, "logarithmic", {}),
}


class Example(gb.TransferFunction):
    """Second order with a zero and a delay; the benchmark's own."""

    input, output = "u", "y"
    b1 = gb.Parameter(0.4, bounds=(-5, 5))
    b0 = gb.Parameter(0.1, bounds=(-5, 5))
    a1 = gb.Parameter(0.9, bounds=(0, 10))
    a0 = gb.Parameter(2.0, bounds=(0, 20))
    T = gb.Parameter(0.2, bounds=(0, 1), unit="s")

    def response(self, s, p):
        """Return the response."""
        return (p.b1 * s + p.b0) / (s**2 + p.a1 * s + p.a0) * gb.exp(-s * p.T)


def cell(label: str, repeats: int, seed: int, say: Callable[[str], None]) -> None:
    """Run one cell and return its line."""
    system, kind, options = CELLS[label]
    scores, squares, points, dof, factors, differ = [], [], [], [], [], 0.0
    for k in range(repeats):
        data = spectral_response(
            flown(system, kind, np.random.default_rng([seed, k]), **options), "u", "y"
        )
        estimate, error = maximum_likelihood(system, data)
        scores.append((estimate - system.truth) / error)
        misses = np.abs(data.response - system.response(1j * data.omega, system.truth)) ** 2
        squares.append(np.mean(misses / data.variance))
        points.append(len(data))
        dof.append(np.median(data.dof))
        if system is EXAMPLE and k < CHECKS:
            start = dict(zip(("b1", "b0", "a1", "a0", "T"), system.truth.tolist(), strict=True))
            independent, asked = (
                gb.fit(
                    gb.Problem(Example(), response, gb.MaximumLikelihood()),
                    starts=[start],
                    progress=False,
                )
                for response in (data.with_independent_errors(), data)
            )
            sizes = np.array([*independent.standard_error.values()])
            differ = max(differ, float(np.abs(sizes / error - 1).max()))
            factors.append(np.array([*asked.standard_error.values()]) / sizes)

    held = 100 * np.mean(np.abs(scores) < 1.96, axis=0)
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    say(
        f"{label:44} {np.mean(points):6.1f} {np.mean(dof):5.0f} {np.mean(squares):7.2f}   "
        + " ".join(f"{share:5.1f}" for share in held)
        + "   "
        + " ".join(f"{ratio:4.2f}" for ratio in rms)
        + (f"   {100 * differ:.1g} %   {np.max(factors):.2f}" if factors else "")
    )


def main() -> None:
    """Run the chosen cells."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()

    lines: list[str] = []

    def say(text: str) -> None:
        print(text, flush=True)
        lines.append(text)

    began = time.perf_counter()
    say(
        f"{options.repeats} records a cell, seed {options.seed}; greybox {gb.__version__}, Python "
        f"{platform.python_version()}, numpy {np.__version__}, "
        f"{dt.datetime.now(tz=dt.UTC):%Y-%m-%d}"
    )
    say(
        f"{'':44} points   dof  |e|²/v   held, %{'':25} rms of error / standard error; gb.fit "
        f"differs by; factor of correlation"
    )
    for label in CELLS:
        if options.only in label:
            cell(label, options.repeats, options.seed, say)
    say(f"{time.perf_counter() - began:.0f} s")
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
