"""How far an answer depends on the processor: the same fits under several kernels of OpenBLAS.

python benchmarks/processors.py [--fits 200] [--output benchmarks/results/processors.txt]

OpenBLAS chooses its matrix products by processor, and every choice rounds differently. The variable
OPENBLAS_CORETYPE forces a choice, so one machine can stand for several. Responses by every
criterion, records by output error (white and slow errors, several records, Huber's rule) and by
prediction error (free gain, process noise, gusts), Fourier integrals of manoeuvres, a record
together with a response, and parameters whose truth is beyond their bound are fitted under each
kernel in a process of its own. Compared with the first kernel: the largest move of an estimate, in
its standard errors, and the largest relative change of a standard error. Beyond 1e-6 of a standard
error, or 1e-3 of the error, a fit is listed. Only a numpy that brings OpenBLAS shows a difference.
"""

import argparse
import datetime as dt
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

import greybox as gb
from greybox.modeling.formulation.included_criteria import CRITERIA

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from hardening_spring import Spring, driven
from lateral_aircraft import disturbed, doublets
from spring_lag_tilt import SPRING, Spring as TwoOutputs

KERNELS = ("Haswell", "SkylakeX", "Prescott")
LARGEST_MOVE = 1e-6  # standard errors
LARGEST_CHANGE = 1e-3  # of a standard error


class Narrow(Spring):
    """The spring with its damping bounded below the truth of 0.8."""

    damping = gb.Parameter(0.4, bounds=(0, 0.5), unit="1/s")


class ShortDelay(LagLagDelay):
    """Two lags whose delay is bounded below the truth of 0.05 s."""

    tau = gb.Parameter(0.01, bounds=(0, 0.02), unit="s")


def points(seed: int) -> gb.FrequencyResponse:
    """Return a response with a relative error of 5 %."""
    columns = {"variance": (0.1 * np.ones(TWO_LAGS_OMEGA.size)) ** 2}
    return measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.05, seed=seed, columns=columns)


def response(seed: int) -> gb.Fit:
    """Fit a response by one of the criteria."""
    criterion = CRITERIA[seed % len(CRITERIA)]
    return gb.fit(gb.Problem(LagLagDelay(), points(seed), criterion), starts=20, progress=False)


def bounded_response(seed: int) -> gb.Fit:
    """Fit a response with a parameter at its bound."""
    return gb.fit(gb.Problem(ShortDelay(), points(seed)), starts=20, progress=False)


def from_declared(problem: Any) -> gb.Fit:
    """Fit from the declared values."""
    return gb.fit(problem, starts=[{}], progress=False)


def white(seed: int) -> gb.Fit:
    """Fit a record with white errors by output error."""
    return from_declared(gb.Problem(Spring(), driven(8.0, noise=0.05, seed=seed)))


def slow(seed: int) -> gb.Fit:
    """Fit a record with errors that stay correlated for a second by output error."""
    record = driven(8.0, seed=seed)
    error = lfilter([0.02], [1, -0.98], np.random.default_rng([seed, 3]).normal(size=400))
    position = record["position"] + error
    return from_declared(gb.Problem(Spring(), record.with_signals(position=position)))


def several(seed: int) -> gb.Fit:
    """Fit three records at once by output error."""
    records = [driven(6.0, noise=0.05, seed=3 * seed + k) for k in range(3)]
    return from_declared(gb.several(Spring(), records))


def bounded_record(seed: int) -> gb.Fit:
    """Fit a record by output error, with a parameter at its bound."""
    return from_declared(gb.Problem(Narrow(), driven(8.0, noise=0.05, seed=seed)))


def gusts(seed: int) -> gb.Record:
    """Return a record of the spring with two outputs under process noise."""
    inputs = doublets(1, 300, 1.0, seed)
    return disturbed(TwoOutputs(), SPRING, inputs, 0.05, {"v": 0.3}, {"x": 0.05, "v": 0.15}, seed)


def free_gain(seed: int) -> gb.Fit:
    """Fit a record by prediction error with a free gain."""
    rule = gb.PredictionError(inputs="held")
    return from_declared(gb.Problem(TwoOutputs(), gusts(seed), rule))


def process_noise(seed: int) -> gb.Fit:
    """Fit a record by prediction error with process noise."""
    rule = gb.PredictionError(process_noise=("v",), inputs="held")
    return from_declared(gb.Problem(TwoOutputs(), gusts(seed), rule))


def gust_state(seed: int) -> gb.Fit:
    """Fit a record by prediction error with a disturbance that lasts."""
    rule = gb.PredictionError(disturbance={"v": "colored"}, inputs="held")
    return from_declared(gb.Problem(TwoOutputs(), gusts(seed), rule))


def robust(seed: int) -> gb.Fit:
    """Fit a record with outliers by output error and Huber's rule."""
    record, random = driven(8.0, noise=0.05, seed=seed), np.random.default_rng([seed, 4])
    spikes = (random.random(len(record)) < 0.02) * random.normal(size=len(record))
    record = record.with_signals(position=record["position"] + spikes)
    return from_declared(gb.Problem(Spring(), record, gb.OutputError(errors="huber")))


def manoeuvre(seed: int) -> gb.Fit:
    """Fit the Fourier integrals of a manoeuvre, by output error or by equation error with gusts."""
    rule = (gb.OutputError(), gb.EquationError(gusts=True))[seed % 2]
    spectrum = gb.spectral.transient_spectrum(gusts(seed), "F", "x", (0.5, 10.0))
    return from_declared(gb.Problem(TwoOutputs(), spectrum, rule))


def joint(seed: int) -> gb.Fit:
    """Fit a record and a response at once."""
    omega = np.geomspace(0.5, 10, 16)
    noise = np.random.default_rng([seed, 5]).normal(size=(2, 16))
    exact = gb.frequency_response(TwoOutputs(), SPRING, omega, output="x").response
    measured = exact * (1 + 0.05 * (noise[0] + 1j * noise[1]))
    data = gb.FrequencyResponse(omega, measured, "F", "x", variance=np.full(16, 0.005))
    in_time = gb.Problem(TwoOutputs(), gusts(seed), gb.OutputError(inputs="held"))
    return from_declared(in_time + gb.Problem(TwoOutputs(), data, gb.MaximumLikelihood()))


KINDS: dict[str, Callable[[int], gb.Fit]] = {
    "response": response,
    "response, bound": bounded_response,
    "record, white": white,
    "record, slow errors": slow,
    "record, bound": bounded_record,
    "three records": several,
    "free gain": free_gain,
    "process noise": process_noise,
    "gust state": gust_state,
    "Huber's rule": robust,
    "manoeuvre": manoeuvre,
    "record and response": joint,
}


def fitted(fits: int) -> None:
    """Print every fit as a line: estimates, standard errors, cost."""
    for number in range(fits):
        kind = list(KINDS)[number % len(KINDS)]
        fit = KINDS[kind](number // len(KINDS))
        error = {
            name: None if math.isnan(value) else float(value)
            for name, value in fit.standard_error.items()
        }
        answer = {"estimate": dict(fit.estimate), "error": error, "cost": float(fit.cost)}
        print(json.dumps(answer), flush=True)


def under(kernel: str, fits: int) -> list[dict[str, Any]]:
    """Return the answers of a child process under a kernel."""
    command = [sys.executable, __file__, "--fits", str(fits), "--child"]
    variables = {**os.environ, "OPENBLAS_CORETYPE": kernel, "OPENBLAS_NUM_THREADS": "1"}
    output = subprocess.run(command, env=variables, check=True, stdout=subprocess.PIPE, text=True)
    return [json.loads(line) for line in output.stdout.splitlines()]


def moves(reference: dict[str, Any], answer: dict[str, Any]) -> tuple[float, float]:
    """Return the largest move of an estimate, in standard errors, and of an error."""
    move = change = 0.0
    for name, error in reference["error"].items():
        other = answer["error"][name]
        if (error is None) != (other is None):
            return math.inf, math.inf
        if error:
            move = max(move, abs(answer["estimate"][name] - reference["estimate"][name]) / error)
            change = max(change, abs(other / error - 1))
    return move, change


def table(answers: dict[str, list[dict[str, Any]]]) -> list[str]:
    """Return the lines of the table, and of the fits that moved too far."""
    lines = [f"{'kind':20} {'kernel':10} fits   move: median  largest   change: median  largest"]
    listed = []
    reference = answers[KERNELS[0]]
    for place, kind in enumerate(KINDS):
        for kernel in KERNELS[1:]:
            pairs = list(zip(reference, answers[kernel], strict=True))[place :: len(KINDS)]
            if not pairs:
                continue
            move, change = np.transpose([moves(*pair) for pair in pairs])
            lines.append(
                f"{kind:20} {kernel:10} {len(pairs):4d}        {np.median(move):7.0e}  "
                f"{move.max():7.0e}"
                f"           {np.median(change):7.0e}  {change.max():7.0e}"
            )
            listed += [
                f"{kind}, number {number}, {kernel}: move {move[number]:.1e}, change "
                f"{change[number]:.1e}"
                for number in np.flatnonzero((move > LARGEST_MOVE) | (change > LARGEST_CHANGE))
            ]
    summary = (
        f"{len(listed)} of {len(reference) * (len(KERNELS) - 1)} moved by more than "
        f"{LARGEST_MOVE:g} "
        f"standard errors, or changed an error by more than {LARGEST_CHANGE:g}"
    )
    return [*lines, summary, *listed]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fits", type=int, default=200)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        fitted(options.fits)
        return

    answers = {kernel: under(kernel, options.fits) for kernel in KERNELS}
    heading = (
        f"{options.fits} fits; greybox {gb.__version__}, Python {platform.python_version()}, "
        f"numpy {np.__version__}, {dt.date.today()}"
    )
    lines = [heading, *table(answers)]
    print("\n".join(lines))
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
