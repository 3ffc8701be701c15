"""What the constants of sine detection and spectral estimates decide, each at other values.

python benchmarks/signal_constants.py [detection] [polynomials]

Detection: of 15 spoiled schedules of six sines and 20 noisy pairs (signal to noise 6 to 100), those
found entirely; of 24 sweeps, those in which no sine was found, and those that were found as one
sweep; of 16 signals without a sine (noise, random walks, squares, steps), those in which none of 3
s was found; and sines of any length found in them.

Polynomials: root mean square error in percent of the response of a resonance of 6
rad/s, damped by 0.3 and by 0.05, from 12 records of 60 s with a sweep and 12 with white noise,
output noise 0.02, 12 frequencies from 1.5 to 12 rad/s.
"""

import math
import sys
from pathlib import Path

import numpy as np
from scipy.signal import freqz, lfilter

from greybox.data.logs import sine_detection
from greybox.data.spectral import local_polynomials, sweeps_and_noise

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from resonance_records import RATE, flown_sweep, record, resonance
from sine_schedules import STEP, schedule

PLAN = [(20.0, 10.0), (8.0, 10.0), (4.0, 15.0), (3.5, 15.0), (2.0, 20.0), (1.0, 40.0)]

DETECTION = {
    "OFF_LINE": (0.02, 0.1, 0.4, 2.0),
    "SWING": ((0.9, 1.1), (0.8, 1.25), (0.3, 3.0), (0.06, 16.0)),
    "TRANSIENT": (0.003, 0.01, 0.1, 0.3),
    "UNEXPLAINED": (0.015, 0.05, 0.3, 0.9),
    "BENT": (0.012, 0.04, 0.4, 1.2),
    "BENT_UNEXPLAINED": (0.05, 0.15, 0.9),
    "FOLLOWS": (0.005, 0.02, 0.15, 0.5),
    "SWEEP_RATIO": (1.03, 1.1, 2.0, 3.0),
    "SWEEP_HALF_PERIODS": (6, 24),
    "SWEEP_PARTS": (3, 9),
    "CROSSINGS": (3, 4, 7, 9),
    "SAMPLES": (2, 4, 16, 40),
    "HEIGHTS": (np.array([0.01]), np.array([0.1]), np.array([0.5]), np.array([0.01, 0.1, 0.5])),
}
POLYNOMIALS = {
    "TRANSIENT_ORDER": (0, 2),
    "VISIBLE": (0.46, 46.0),
    "CERTAIN": (5.0, 92.0),
    "LEAST_RESIDUALS": (2, 6),
    "NEIGHBORHOOD": (4, 30),
    "STEEP": (0.1, 10.0),
    "WIDEST": (0.1, 0.8),
}


def found_all(runs, plan, starts, within):
    """Whether exactly the planned sines were detected: frequency, amplitude (3), time."""
    return [run.kind for run in runs] == ["sine"] * len(plan) and all(
        abs(run.omega / omega - 1) < 2e-3
        and abs(run.amplitude / 3 - 1) < 0.1
        and abs(run.start - start) < within * math.pi / omega
        and abs(run.end - end) < within * math.pi / omega
        for run, (omega, _), (start, end) in zip(runs, plan, starts, strict=True)
    )


def schedules():
    for pause in (0.0, 2.0, 7.0):
        t, r, starts = schedule(PLAN, pause)
        held = r[np.searchsorted(t, np.floor(t / 0.012) * 0.012)]
        for values in (r, held, r + 5, r + np.where(t < 3, -20.0, 0.0), np.round(r, 1)):
            yield found_all(sine_detection.sines_and_sweeps(t, values), PLAN, starts, 1.0)


def noisy(rng):
    for _ in range(20):
        ratio = math.exp(rng.uniform(math.log(6), math.log(100)))
        omega = rng.uniform(1, 15)
        plan = [(omega, 15 + 20 / omega), (1.3 * omega, 15 + 20 / omega)]
        t, r, starts = schedule(plan)
        runs = sine_detection.sines_and_sweeps(t, r + 3 / ratio * rng.standard_normal(t.size))
        yield found_all([run for run in runs if run.amplitude > 1], plan, starts, 8.0)


def sweeps(rng):
    for k in range(24):
        low = rng.uniform(0.3, 3)
        factor = rng.uniform(5, 60)
        duration = rng.uniform(30, 90)
        t = np.arange(0, duration, STEP)
        x = t / duration
        phase = (
            low
            * duration
            * ((factor**x - 1) / math.log(factor) if k % 2 else x + (factor - 1) * x**2 / 2)
        )
        yield [
            run.kind
            for run in sine_detection.sines_and_sweeps(t, np.sin(phase)[:: -1 if k % 4 > 1 else 1])
        ]


def without_sines():
    t = np.arange(0, 60, STEP)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        white = rng.standard_normal(t.size)
        for values in (
            white,
            np.cumsum(white),
            np.sign(np.sin(2 * t)),
            np.repeat(rng.standard_normal(60), 100),
        ):
            yield [
                run.duration
                for run in sine_detection.sines_and_sweeps(t, values)
                if run.kind == "sine"
            ]


def detection_row(label):
    rng = np.random.default_rng(1)
    pairs = list(noisy(rng))
    kinds = list(sweeps(rng))
    spurious = list(without_sines())
    print(
        f"{label:34} {sum(schedules()):9} {sum(pairs):6} {sum('sine' not in k for k in kinds):8} "
        f"{sum(k == ['sweep'] for k in kinds):10} {sum(max(d, default=0) < 3 for d in spurious):8} "
        f"{sum(map(len, spurious)):9}",
        flush=True,
    )


def response_error(damping, kind):
    b, a = resonance(6.0, damping)
    squares = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        u = rng.standard_normal(60 * RATE) if kind == "noise" else flown_sweep()
        y = lfilter(b, a, u) + 0.02 * rng.standard_normal(u.size)
        omega = np.geomspace(1.5, 12, 12)
        got = sweeps_and_noise.spectral_response(record(u=u, theta=y), omega=omega)
        squares.append(np.abs(got.response / freqz(b, a, got.omega / RATE)[1] - 1) ** 2)
    return 100 * math.sqrt(np.mean(squares))


def response_row(label):
    errors = [
        response_error(damping, kind) for kind in ("sweep", "noise") for damping in (0.3, 0.05)
    ]
    print(f"{label:34} " + " ".join(f"{error:10.2f}" for error in errors), flush=True)


def vary(module, constants, row):
    row("as it is")
    for name, values in constants.items():
        used = getattr(module, name)
        for value in values:
            setattr(module, name, value)
            row(f"{name} = {value}")
        setattr(module, name, used)


def main():
    chosen = sys.argv[1:] or ["detection", "polynomials"]
    if "detection" in chosen:
        print(
            f"{'':34} {'schedules':9} {'noisy':6} {'no sine':8} {'one sweep':10} {'none':8} "
            f"{'spurious':9}"
        )
        print(f"{'of':34} {15:9} {20:6} {24:8} {24:10} {16:8}")
        vary(sine_detection, DETECTION, detection_row)
    if "polynomials" in chosen:
        print(
            f"\n{'':34} {'sweep 0.3':>10} {'sweep 0.05':>10} {'noise 0.3':>10} {'noise 0.05':>10}"
        )
        vary(local_polynomials, POLYNOMIALS, response_row)


if __name__ == "__main__":
    main()
