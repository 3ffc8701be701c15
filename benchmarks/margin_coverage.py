"""How often the intervals of stability margins contain the true margins: flights of known truth.

python benchmarks/margin_coverage.py [--repeats 200] [--only rate] [--output FILE]

Every plant is flown in the loop of its controller, with noise of the gyro and gusts; the log is
rounded to the steps of a 16-bit gyro. The test is a sweep at the control, a sweep at the setpoint,
or a multisine at the setpoint. From each flight: response, fit, margins of the loop broken at the
control. The true margins are those of the true plant, whose loop diverges in a flight with more
gain (see tests/workflows/experiment/test_margins.py).
Printed: the share of intervals that hold the truth in percent, and half the mean width.
"""

import argparse
from collections import Counter
from dataclasses import replace
from datetime import date
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.stats import binom

import greybox as gb

TESTS = ("sweep at u", "sweep at reference", "multisine at reference")
PERIOD, PERIODS = 15.0, 5  # of the multisine, s; the first one settles
STEPS = {"q": 1e-3, "u": 1e-4}  # of the log, rad/s and 1

NAMES = (
    "phase margin",
    "gain margin",
    "gain reduction margin",
    "delay margin",
    "modulus margin",
    "crossover",
    "disturbance rejection bandwidth",
    "disturbance rejection peak",
    "bandwidth",
    "-180 deg frequency",
    "ADS-33 gain bandwidth",
    "ADS-33 phase bandwidth",
    "ADS-33 bandwidth",
    "phase delay",
    "overshoot",
    "rise time",
    "settling time",
    "damping ratio",
    "natural frequency",
)


class Rate(gb.StateSpace):
    """Angular rate per control: a motor, damping, delay; gusts act on the angular acceleration."""

    states, inputs, outputs, delays = ("q", "m"), ("u",), ("q",), {"u": "tau"}
    units = {"q": "rad/s"}
    K = gb.Parameter(40.0, bounds=(0.1, 4000), scale="log")
    a = gb.Parameter(2.0, bounds=(-50, 50))
    T = gb.Parameter(0.05, bounds=(0.002, 1), scale="log")
    tau = gb.Parameter(0.02, bounds=(0, 0.2))

    def derivative(self, x, u, p):  # noqa: D102
        return (p.K * x.m - p.a * x.q, (u.u - x.m) / p.T)

    def output(self, x, u, p):  # noqa: D102
        return (x.q,)


class RateLoop(gb.Controller):
    """Proportional-integral control of the rate."""

    states, inputs, outputs = ("integral",), ("q",), ("u",)
    K_P = gb.Parameter(0.1)
    K_I = gb.Parameter(0.2)

    def update(self, x, u, p):  # noqa: D102
        error = u.reference - u.q
        return (x.integral + error / self.rate,), (p.K_P * error + p.K_I * x.integral,)


# Of each plant: true values, gains, controller rate in Hz, band of the test in rad/s.
PLANTS = {
    "quadcopter": (
        {"K": 90.0, "a": 0.7, "T": 0.05, "tau": 0.008},
        {"K_P": 0.1, "K_I": 0.1},
        400,
        (2, 60),
    ),
    "small, 1 kHz": (
        {"K": 400.0, "a": 3.0, "T": 0.025, "tau": 0.004},
        {"K_P": 0.05, "K_I": 0.1},
        1000,
        (4, 150),
    ),
    "unstable": (
        {"K": 40.0, "a": -2.0, "T": 0.05, "tau": 0.02},
        {"K_P": 0.2, "K_I": 0.1},
        100,
        (1, 40),
    ),
    "slow loop": (
        {"K": 20.0, "a": 1.0, "T": 0.1, "tau": 0.03},
        {"K_P": 0.15, "K_I": 0.2},
        50,
        (0.5, 25),
    ),
    "helicopter": (
        {"K": 15.0, "a": 8.0, "T": 0.03, "tau": 0.05},
        {"K_P": 0.5, "K_I": 2.0},
        100,
        (0.7, 40),
    ),
}


@lru_cache
def excitation(test, band, rate):
    """Return the test signal: a minute of a sweep, or 75 seconds of a multisine."""
    kind, _, signal = test.split()
    amplitude = 0.1 if signal == "u" else 0.3
    if kind == "sweep":
        return gb.experiment.sweep(*band, 60.0, rate, amplitude=amplitude, signal=signal)
    return gb.experiment.multisine(
        *band, PERIOD, rate, amplitude=amplitude, signals=(signal,), periods=PERIODS
    )


def flown(values, gains, rate, band, test, seed):
    """Return the record of one flight, as it is logged."""
    record = gb.virtual_flight(
        Rate(),
        values,
        excitation(test, band, rate),
        controller=RateLoop(gains, rate=rate),
        noise={"q": 0.01},
        process_noise={"q": 0.02},
        seed=seed,
    )
    logged = {n: s * np.round(record[n] / s) for n, s in STEPS.items()}
    return replace(record, signals={**record.signals, **logged})


def measured(record, test, band):
    """Return the response of the plant in a flight."""
    kind, _, signal = test.split()
    added = "u_excitation" if signal == "u" else signal
    if kind == "sweep":
        return gb.spectral.spectral_response(record, "u", "q", instrument=added, band=band)
    settled = record.between(PERIOD, PERIOD * PERIODS)
    return gb.spectral.periodic_response(settled, PERIOD, "u", "q", instrument=added)


def counted(plant, test, repeats):
    """Return how many intervals hold the truth and their mean half widths, by name."""
    values, gains, rate, band = PLANTS[plant]
    controller = RateLoop(gains, rate=rate)
    truth = gb.margins(Rate(), controller, values)
    held, widths = dict.fromkeys(NAMES, 0), dict.fromkeys(NAMES, 0.0)
    for seed in range(repeats):
        response = measured(flown(values, gains, rate, band, test, seed), test, band)
        problem = gb.Problem(Rate(), response, gb.MaximumLikelihood())
        answer = gb.margins(gb.fit(problem, progress=False), controller)
        if not answer.is_stable:  # a miss of every margin
            continue
        for name in NAMES:
            margin = answer[name]
            held[name] += bool(margin.low <= truth[name].value <= margin.high)
            widths[name] += (margin.high - margin.low) / 2 / repeats
    return truth, held, widths


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--only", default="")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    repeats = options.repeats
    low, high = binom.interval(0.999, repeats, 0.95)
    lines = [f"{repeats} flights a cell; of each quantity: truth, % held, mean half width"]
    print(lines[0], flush=True)
    totals, cells, outside = Counter(), [], []
    for plant in PLANTS:
        for test in TESTS:
            label = f"{plant}, {test}"
            if options.only not in label:
                continue
            truth, held, widths = counted(plant, test, repeats)
            totals.update(held)
            # The interval of a quantity that no error changes, such as an infinite margin, always
            # contains it.
            counts = {n: held[n] for n in NAMES if widths[n] > 0}
            cells += counts.values()
            outside += [
                f"{label}, {n} {100 * count / repeats:.1f} %"
                for n, count in counts.items()
                if not low <= count <= high
            ]
            numbers = [
                f"{name} {truth[name].value:.4g} {100 * held[name] / repeats:.1f} % "
                f"{widths[name]:.2g}"
                for name in NAMES
            ]
            lines.append(f"{label}: " + "; ".join(numbers))
            print(lines[-1], flush=True)

    flights = max(len(lines) - 1, 1) * repeats
    shares = [f"{name} {100 * totals[name] / flights:.1f} %" for name in NAMES]
    lines.append(f"all {flights} flights: {'; '.join(shares)}")
    between = np.mean([0.93 * repeats <= count <= 0.97 * repeats for count in cells])
    exact = binom.cdf(np.floor(0.97 * repeats), repeats, 0.95)
    exact -= binom.cdf(np.ceil(0.93 * repeats) - 1, repeats, 0.95)
    lines.append(
        f"{100 * between:.0f} % of {len(cells)} cells are between 93 and 97 %; of exact intervals, "
        f"{100 * exact:.0f} % would be."
    )
    lines.append(
        f"Outside {100 * low / repeats:.1f} to {100 * high / repeats:.1f} %, where 99.9 % of exact "
        f"cells are: {'; '.join(outside) or 'none'}"
    )
    print("\n".join(lines[-3:]), flush=True)
    if options.output:
        head = f"greybox {gb.__version__}, {date.today()}"
        options.output.write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
