"""Delays from held controls: single sines, a sweep and the record of the same flights.

A pitch axis with a delay of 10 ms flies in a sampled loop, whose controls are held between samples,
which `Record.hold` states. The table counts how often the 95 % interval of the delay contains it,
and its mean error in standard errors; once as the fit divides the hold out of the response, and
once with the hold as a part of the model's delay.

    python benchmarks/hold_coverage.py [--runs 60] [--output benchmarks/results/hold_coverage.txt]
"""

import argparse
import datetime as dt
import platform
from dataclasses import replace
from pathlib import Path

import numpy as np

import greybox as gb
from greybox.models.ardupilot import AngleController, RateController
from greybox.models.rate import DampedAngle

TRUTH = {"K_phi": 90.0, "a": 0.7, "T_rotor": 0.05, "T_delay": 0.01}
BAND = (1.5, 18.0)


def controllers(rate: float) -> list[gb.Controller]:
    values = {"FLTT": 0.0, "FLTD": 0.0, "D": 0.002}
    angle = AngleController({"acceleration": 0.0, "delay": 0}, rate=rate)
    return [angle, RateController(values, rate=rate, signals={"q": "theta_dot"})]


def flown(excitation: gb.experiment.Excitation, rate: float, seed: int) -> gb.Record:
    loop, noise = controllers(rate), {"theta": 2e-3}
    return gb.virtual_flight(
        DampedAngle(), TRUTH, excitation, controller=loop, noise=noise, seed=seed
    )


def single_sines(rate: float, seed: int):
    test = gb.experiment.sine_schedule(np.geomspace(1.5, 9.5, 6), 0.05, rate=rate)
    record = flown(test, rate, seed)
    segments = gb.logs.find_segments(record, setpoint="reference")
    return gb.spectral.finite_frequency(record, segments).response


def sweep(rate: float, seed: int):
    test = gb.experiment.sweep(*BAND, 60, rate, amplitude=0.05, signal="u")
    record = flown(test, rate, seed)
    return gb.spectral.spectral_response(record, instrument="u_excitation", band=BAND)


def record(rate: float, seed: int):
    test = gb.experiment.sweep(*BAND, 20, rate, amplitude=0.05, signal="u")
    return flown(test, rate, seed)


def numbers(data, runs: int) -> str:
    rule = gb.OutputError() if isinstance(data(0), gb.Record) else gb.MaximumLikelihood()
    hits, errors = [], []
    for seed in range(runs):
        problem = gb.Problem(DampedAngle(), data(seed), rule)
        fit = gb.fit(problem, starts=[TRUTH], progress=False, profiles=False)
        low, high = fit.interval()["T_delay"]
        hits.append(low <= TRUTH["T_delay"] <= high)
        errors.append((fit.estimate["T_delay"] - TRUTH["T_delay"]) / fit.standard_error["T_delay"])
    return f"{100 * np.mean(hits):5.1f} %, mean error {np.nanmean(errors):5.1f} standard errors"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines = [f"greybox {gb.__version__}, {dt.date.today()}, Python {platform.python_version()}"]
    for rate in (50.0, 100.0):
        for measured in (single_sines, sweep):
            taken = [measured(rate, seed) for seed in range(options.runs)]
            apart = numbers(taken.__getitem__, options.runs)
            whole = numbers(lambda k, taken=taken: replace(taken[k], about={}), options.runs)
            lines.append(f"{measured.__name__} at {rate:g} Hz: delay held {apart}")
            lines.append(f"  with the hold in the delay: {whole}")
        if rate == 100:
            of_record = numbers(lambda k: record(100.0, k), options.runs)
            lines.append(f"record of 20 s at {rate:g} Hz: delay held {of_record}")
        print("\n".join(lines[-5:]), flush=True)
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
