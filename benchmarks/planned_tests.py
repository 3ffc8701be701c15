"""Planned sines: what they achieve in virtual flights, and equally spaced ones of equal time.

python benchmarks/planned_tests.py [--flights 40] [--output FILE]

The tilt dynamics of the paper under a sampled controller with a noisy angle: the record of every
flight is fitted by output error, and the scatter of the estimates is held against the expected
standard errors.
"""

import argparse
import sys
from datetime import date
from importlib.metadata import version

import numpy as np

import greybox as gb
from greybox.models.controller import AttitudeController
from greybox.models.tilt import NonlinearTilt
from greybox.workflows.experiment import SinePlan, plan_sines, sine_schedule

VALUES = {"a1": -14.6, "a2": 3.0, "a3": 8.5, "a4": 295.0, "C_x": 0.05}
WANTED = {"a1": 0.05, "a2": 0.008, "a3": 0.012, "a4": 0.4}
CONTROLLER = AttitudeController(rate=100)
NOISE = 0.002  # rad
BAND = (0.8, 30)


def planned() -> SinePlan:
    """Plan sines for the tilt."""
    return plan_sines(
        NonlinearTilt(),
        VALUES,
        WANTED,
        band=BAND,
        amplitude=0.05,
        noise=NOISE,
        controller=CONTROLLER,
        limits={"theta": 0.04, "u": 0.2},
        fixed={"C_x": 0.05},
    )


def equally_spaced(plan: SinePlan) -> gb.experiment.Excitation:
    """Return as many sines at equally spaced log frequencies that fill the same flight."""
    omega = np.geomspace(*BAND, len(plan.omega))
    amplitude = np.interp(np.log(omega), np.log(plan.omega), plan.amplitude)
    low, high = 1.0, plan.flight_time
    for _ in range(40):
        least = (low + high) / 2
        made = sine_schedule(
            omega.tolist(), amplitude.tolist(), periods=1, least=least, rate=plan.rate
        )
        low, high = (least, high) if made.time[-1] < plan.flight_time else (low, least)
    return sine_schedule(omega.tolist(), amplitude.tolist(), periods=1, least=low, rate=plan.rate)


def scatter(excitation: gb.experiment.Excitation, flights: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the standard deviation of the estimates, and the median printed standard error."""
    estimates, printed = [], []
    for seed in range(flights):
        record = gb.virtual_flight(
            NonlinearTilt(),
            VALUES,
            excitation,
            controller=CONTROLLER,
            noise={"theta": NOISE},
            seed=seed,
        )
        measured = {
            name: record[name] for name in ("u", "theta")
        }  # a velocity without noise would determine everything
        hold = {name: record.hold[name] for name in measured}
        data = gb.Record(record.time, measured, hold=hold)
        problem = gb.Problem(NonlinearTilt(), data, fixed={"C_x": 0.05})
        fit = gb.fit(problem, starts=[{name: VALUES[name] for name in WANTED}], progress=False)
        estimates.append([fit.estimate[name] for name in WANTED])
        printed.append([fit.standard_error[name] for name in WANTED])
    errors = np.array(estimates) - np.array([VALUES[name] for name in WANTED])
    return np.sqrt(np.mean(errors**2, axis=0)), np.nanmedian(printed, axis=0)


def main() -> None:
    """Fly both and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--output")
    options = parser.parse_args()
    plan = planned()
    lines = [
        f"{date.today()}, greybox-id {version('greybox-id')}, {options.flights} flights each",
        "",
        str(plan),
        "",
    ]
    found, printed = scatter(plan.excitation(), options.flights)
    spaced, _ = scatter(equally_spaced(plan), options.flights)
    expected = np.array([plan.standard_error[name] for name in WANTED])
    lines.append(
        "                    " + "".join(f"{name:>8}" for name in WANTED) + "  geometric mean"
    )
    for label, ratio in (
        ("achieved/expected", found / expected),
        ("printed/expected", printed / expected),
        ("equally spaced/planned", spaced / found),
    ):
        mean = float(np.exp(np.mean(np.log(ratio))))
        lines.append(f"{label:22}" + "".join(f"{value:8.2f}" for value in ratio) + f"{mean:10.2f}")
    text = "\n".join(lines)
    print(text)
    if options.output:
        with open(options.output, "w", encoding="utf-8") as file:
            file.write(text + "\n")


if __name__ == "__main__":
    sys.exit(main())
