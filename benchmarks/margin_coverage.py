"""How often the intervals of stability margins hold the true margins: flights of known truth.

python benchmarks/margin_coverage.py [--repeats 60] [--only rate] [--output FILE]

Every plant is flown in the loop of its controller, with noise of the gyro and gusts. From each
flight: response, fit, margins of the loop broken at the control. The true margins are those of the
true plant, whose loop diverges in a flight with more gain (see tests/experiment/test_margins.py).
Printed: the share of intervals that hold the truth in percent, and half the mean width.
"""

import argparse
from collections import Counter
from pathlib import Path

import greybox as gb

NAMES = (
    "phase margin",
    "gain margin",
    "delay margin",
    "modulus margin",
    "crossover",
    "disturbance rejection bandwidth",
    "disturbance rejection peak",
    "bandwidth",
    "-180 deg frequency",
    "ADS-33 gain bandwidth",
    "ADS-33 phase bandwidth",
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


def flown(values, gains, rate, band, signal, seed):
    """Return the record of one flight.

    Sixty seconds of a logarithmic sweep, added to the control or the setpoint.
    """
    amplitude = 0.1 if signal == "u" else 0.3
    test = gb.experiment.sweep(*band, 60.0, rate, amplitude=amplitude, signal=signal)
    return gb.virtual_flight(
        Rate(),
        values,
        test,
        controller=RateLoop(gains, rate=rate),
        noise={"q": 0.01},
        process_noise={"q": 0.02},
        seed=seed,
    )


def counted(plant, signal, repeats):
    """Return how many intervals hold the truth and their mean half widths, by name."""
    values, gains, rate, band = PLANTS[plant]
    controller = RateLoop(gains, rate=rate)
    truth = gb.margins(Rate(), controller, values)
    held, widths = dict.fromkeys(NAMES, 0), dict.fromkeys(NAMES, 0.0)
    for seed in range(repeats):
        record = flown(values, gains, rate, band, signal, seed)
        added = "u_excitation" if signal == "u" else signal
        response = gb.spectral.spectral_response(record, "u", "q", instrument=added, band=band)
        problem = gb.Problem(Rate(), response, gb.MaximumLikelihood())
        answer = gb.margins(gb.fit(problem, starts=4, progress=False), controller)
        if not answer.is_stable:  # a miss of every margin
            continue
        for name in NAMES:
            margin = answer[name]
            held[name] += bool(margin.low <= truth[name].value <= margin.high)
            widths[name] += (margin.high - margin.low) / 2 / repeats
    return truth, held, widths


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--only", default="")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines = [f"{options.repeats} flights a cell; of each margin: truth, % held, mean half width"]
    print(lines[0], flush=True)
    totals, cells = Counter(), 0
    for plant in PLANTS:
        for signal in ("u", "reference"):
            label = f"{plant}, sweep at {signal}"
            if options.only not in label:
                continue
            truth, held, widths = counted(plant, signal, options.repeats)
            totals.update(held)
            cells += 1
            numbers = [
                f"{name} {truth[name].value:.4g} {100 * held[name] / options.repeats:.1f} % "
                f"{widths[name]:.2g}"
                for name in NAMES
            ]
            lines.append(f"{label}: " + "; ".join(numbers))
            print(lines[-1], flush=True)
    flights = max(cells, 1) * options.repeats
    shares = [f"{name} {100 * totals[name] / flights:.1f} %" for name in NAMES]
    lines.append(f"all {flights} flights: {'; '.join(shares)}")
    print(lines[-1], flush=True)
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
