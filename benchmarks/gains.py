"""Whether gains that `greybox.safe_gains` proposes are better in truth.

python benchmarks/gains.py [--seeds 10] [--only NAME] [--output FILE]

Ten loops of known truth with the controllers of ArduPilot, PX4 and Betaflight: three well tuned,
seven badly. The response of each plant is measured with random errors of known variance, and
fitted; `safe_gains` then tunes P and D. The true plant with today's gains and with the proposed
ones says which rows of the comparison are better in truth.
Printed for each loop: how often gains are proposed; how many rows that the verdict calls better are
better in truth, and whether all rows of a proposal are; how often the true loop misses a
requirement, and by how much of it at most; how often it is unstable.
"""

import argparse
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

import greybox as gb
from greybox.models import ardupilot, betaflight, px4
from greybox.workflows.experiment.sampled_loop import linear_controller, sampled_loop
from greybox.workflows.experiment.todays_loop import todays_loop

PHASE_MARGIN, GAIN_MARGIN = 45.0, 6.0
POINTS = 25  # of a measured response
ERROR = (
    0.03  # relative standard deviation of its real and imaginary part, usual for a sweep of 60 s
)


class Attitude(gb.TransferFunction):
    """Angle per control: a rotor's lag, damping and a delay."""

    input, output = "u", "theta"
    units = {"theta": "rad"}
    K = gb.Parameter(100.0, bounds=(1, 10000), scale="log")
    a = gb.Parameter(1.0, bounds=(-20, 50))
    T = gb.Parameter(0.04, bounds=(0.002, 0.5), scale="log")
    tau = gb.Parameter(0.01, bounds=(0, 0.1))

    def response(self, s, p):  # noqa: D102
        return p.K * gb.exp(-p.tau * s) / (s * (s + p.a) * (p.T * s + 1))


class Rate(Attitude):
    """The same for an angular rate."""

    output = "q"
    units = {"q": "rad/s"}

    def response(self, s, p):  # noqa: D102
        return p.K * gb.exp(-p.tau * s) / ((s + p.a) * (p.T * s + 1))


@dataclass(frozen=True)
class Loop:
    """A plant of known truth with its controllers.

    The band is that of its test in rad/s.
    """

    model: gb.TransferFunction
    truth: dict
    controllers: list
    band: tuple
    is_well_tuned: bool = False

    @property
    def gains(self):
        """The names of P and D of the rate controller."""
        prefix = "RateController." if len(self.controllers) > 1 else ""
        return ["RateController.P", "D"] if prefix else ["P", "D"]

    @property
    def gains_flown(self):
        """Today's gains of the rate controller."""
        return self.controllers[-1].values


QUADCOPTER = {"K": 91.0, "a": 0.7, "T": 0.05, "tau": 0.006}
LARGE = {"K": 35.0, "a": 0.5, "T": 0.09, "tau": 0.02}
SMALL = {"K": 120.0, "a": 1.0, "T": 0.03, "tau": 0.01}
RACER = {"K": 700.0, "a": 3.0, "T": 0.012, "tau": 0.002}


def copter(truth, gains, **options):
    """Return a loop with the controllers of ArduPilot."""
    own = {"q": "theta_dot"}
    laws = [ardupilot.AngleController(), ardupilot.RateController(gains, signals=own)]
    return Loop(Attitude(), truth, laws, (1, 40), **options)


def multicopter(truth, gains, **options):
    """Return a loop with the controllers of PX4."""
    own = {"q": "theta_dot"}
    laws = [px4.AngleController(), px4.RateController(gains, signals=own)]
    return Loop(Attitude(), truth, laws, (1, 60), **options)


def racer(truth, gains, **options):
    """Return a loop with the rate controller of Betaflight."""
    return Loop(Rate(), truth, [betaflight.RateController(gains)], (3, 250), **options)


LOOPS = {
    "ArduPilot, well": copter(QUADCOPTER, {"P": 0.16, "I": 0.16, "D": 0.005}, is_well_tuned=True),
    "ArduPilot, sluggish": copter(QUADCOPTER, {"P": 0.08, "I": 0.08, "D": 0.0025}),
    "ArduPilot, little D": copter(QUADCOPTER, {"P": 0.2, "I": 0.2, "D": 0.0015}),
    "ArduPilot, large, sluggish": copter(LARGE, {"P": 0.12, "I": 0.06, "D": 0.008}),
    "PX4, well": multicopter(SMALL, {"P": 0.15, "I": 0.2, "D": 0.004}, is_well_tuned=True),
    "PX4, sluggish": multicopter(SMALL, {"P": 0.07, "I": 0.1, "D": 0.0015}),
    "PX4, hardly stable": multicopter(SMALL, {"P": 0.35, "I": 0.3, "D": 0.002}),
    "Betaflight, well": racer(RACER, {"P": 50.0, "I": 80.0, "D": 32.0}, is_well_tuned=True),
    "Betaflight, sluggish": racer(RACER, {"P": 20.0, "I": 60.0, "D": 12.0}),
    "Betaflight, hardly stable": racer(RACER, {"P": 110.0, "I": 80.0, "D": 15.0}),
}


def measured(loop, seed):
    """Return the response of the true plant with random errors; it contains the hold."""
    rate = loop.controllers[0].rate
    omega = np.geomspace(*loop.band, POINTS)
    late = loop.truth | {"tau": loop.truth["tau"] + 0.5 / rate}
    exact = gb.frequency_response(loop.model, late, omega)
    random = np.random.default_rng([seed, int(loop.truth["K"]), round(100 * loop.gains_flown["P"])])
    errors = ERROR * (random.normal(size=POINTS) + 1j * random.normal(size=POINTS))
    variance = 2 * ERROR**2 * np.abs(exact.response) ** 2
    return gb.FrequencyResponse(
        omega, exact.response * (1 + errors), exact.input, exact.output, variance=variance
    )


def changed(loop, gains):
    """Return the controllers with other gains."""
    own = {name.removeprefix("RateController."): value for name, value in gains.items()}
    laws = list(loop.controllers)
    last = laws[-1]
    laws[-1] = type(last)({**last.values, **own}, rate=last.rate, signals=last.signals)
    return laws


def truth_of(loop, gains):
    """Return today's loop with the true plant, and its rows with the proposed gains."""
    values = np.array([[*loop.model.values(loop.truth).values()]])
    plants = sampled_loop(loop.model, values, loop.controllers)
    today = todays_loop(loop.controllers, plants, 0, "u")
    control = linear_controller(changed(loop, gains), plants.sensors, plants.inputs)
    return today, {row.name: row for row in today.changes(control, 0.95)[1]}


def missed(rows):
    """Return by which share of a requirement the true loop misses it; 0 if it meets all."""
    wanted = {
        "phase margin": PHASE_MARGIN,
        "gain margin": GAIN_MARGIN,
        "gain reduction margin": GAIN_MARGIN,
    }
    return max(1 - rows[name].changed / least for name, least in wanted.items())


def judged(loop, seed):
    """Return what is claimed of a proposal and true, or None if today's gains are kept."""
    problem = gb.Problem(loop.model, measured(loop, seed), gb.MaximumLikelihood())
    fit = gb.fit(problem, starts=4, profiles=False, progress=False)
    safe = gb.safe_gains(
        fit,
        loop.controllers,
        loop.gains,
        phase_margin=PHASE_MARGIN,
        gain_margin=GAIN_MARGIN,
        moment=0.1 if loop.model.output == "theta" else 0.05,
    )
    if not safe.best:
        return None, safe.verdict
    _, rows = truth_of(loop, safe.best)
    claims = [change.name for change in safe.comparison.judged("better")]
    right = [rows[name].worsening < 1 for name in claims]
    # A row that gets worse in truth must not be called as good.
    quiet = [c.name for c in safe.comparison.judged("as good")]
    silent = [name for name in quiet if rows[name].worsening > 1.02]
    is_stable = all(np.isfinite(row.changed) or row.unit in ("dB", "deg") for row in rows.values())
    return (right, silent, missed(rows), is_stable), safe.verdict


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", default="")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines = [
        f"greybox {gb.__version__}, {date.today()}, {options.seeds} measurements of each loop",
        f"{'':28}{'proposed':>9}{'rows true':>12}{'all true':>10}{'margins missed':>16}"
        f"{'by at most':>12}{'unstable':>10}",
    ]
    print("\n".join(lines), flush=True)
    total = np.zeros(7)
    largest = 0.0
    for name, loop in LOOPS.items():
        if options.only not in name:
            continue
        answers = [judged(loop, seed) for seed in range(options.seeds)]
        kept = answers[0][1]
        proposals = [answer for answer, _ in answers if answer]
        claims = [row for right, *_ in proposals for row in right]
        misses = [share for _, _, share, _ in proposals]
        counts = np.array(
            [
                len(proposals),
                sum(claims),
                len(claims),
                sum(all(right) for right, *_ in proposals),
                sum(share > 0 for share in misses),
                sum(not is_stable for *_, is_stable in proposals),
                sum(bool(silent) for _, silent, *_ in proposals),
            ]
        )
        total += counts
        largest = max([largest, *misses])
        lines.append(printed(name, counts, max([0.0, *misses]), options.seeds))
        print(lines[-1], flush=True)
        print(f"    first: {kept}", flush=True)
        lines.append(f"    first: {kept}")
    lines.append(printed("all", total.astype(int), largest, options.seeds * len(LOOPS)))
    print(lines[-1])
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


def printed(name, counts, largest, count):
    proposed, right, claims, whole, misses, unstable, _ = counts
    return (
        f"{name:28}{f'{proposed}/{count}':>9}{f'{right}/{claims}':>12}"
        f"{f'{whole}/{proposed}':>10}{f'{misses}/{proposed}':>16}{f'{100 * largest:.1f} %':>12}"
        f"{unstable:>10}"
    )


if __name__ == "__main__":
    main()
