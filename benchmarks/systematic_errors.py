"""What a log cannot resolve: the systematic errors that `gb.identify` prints, held against truth.

python benchmarks/systematic_errors.py [--flights 10] [--seed 0] [--output FILE]

Long calm sweeps of a quadcopter's pitch under control, whose scatter is small. The log is as fine
as the flight, or it truncates the angle, or it does not state that the control is held. Printed per
cell: the share of 95 % intervals that hold the truth of K, a, τ and the delay T; the same if the
systematic share were left out of the standard error; root mean square errors over the standard
error; and the median systematic share of it.
"""

import argparse
import datetime as dt
import platform
import warnings
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy.linalg import expm

import greybox as gb
from greybox.data.record import Recording
from greybox.models.rate import DampedAngle

K, A, TAU = 91.0, 0.681, 0.05  # 1/s², 1/s, s
LATE = 6  # passes of the controller, 15 ms
TRUTH = {"K_phi": K, "a": A, "T_rotor": TAU, "T_delay": 0.015}
STEP, LOGGED = 0.0025, 2  # s, of the controller; passes for every row of the log
REST, DURATION, BAND, AMPLITUDE = 8.0, 90.0, (0.1, 6.0), 0.08  # s, s, Hz, of the control
ANGLE_GAIN, RATE_GAIN, RATE_TIME = 4.5, 0.135, 1.0  # 1/s, s, s
GYRO, ATTITUDE = 0.003, 0.0002  # noise, rad/s and rad
GUST, GUST_TIME = 0.05, 1.0  # rad/s², s
FINE = 1e-6  # deg
# Steps of the angle in deg, and whether the log states that a control lasts 2.5 ms.
CELLS = {
    "as flown": (FINE, True),
    "angle truncated to 0.1°": (0.1, True),
    "angle truncated to 0.5°": (0.5, True),
    "hold unstated": (FINE, False),
    "both": (0.5, False),
}


def flown(flights, seed):
    """Return time (n,), control and angle (n, flights), and injected signal (n,), as logged.

    The plant K / ((τ s + 1) s (s + a)) takes exact steps under a held and delayed control.
    """
    random = np.random.default_rng(seed)
    steps = round((DURATION + 2 * REST) / STEP)
    time = STEP * np.arange(steps)
    t = np.clip(time - REST, 0, DURATION)
    growth = np.log(BAND[1] / BAND[0])
    phase = 2 * np.pi * BAND[0] * DURATION / growth * np.expm1(growth * t / DURATION)
    injected = AMPLITUDE * np.clip(np.minimum(t, DURATION - t) / 2, 0, 1) * np.sin(phase)

    # Moment, rate, angle, gust, and the control.
    dynamics = np.zeros((5, 5))
    dynamics[0, [0, 4]] = -1 / TAU, 1 / TAU
    dynamics[1, [0, 1, 3]] = K, -A, 1
    dynamics[2, 1] = 1
    dynamics[3, 3] = -1 / GUST_TIME
    advance = expm(STEP * dynamics)
    x, integral = np.zeros((5, flights)), np.zeros(flights)
    controls, angles = np.zeros((2, steps, flights))
    shaking = GUST * np.sqrt(-np.expm1(-2 * STEP / GUST_TIME))
    for n in range(steps):
        gyro = x[1] + GYRO * random.standard_normal(flights)
        angles[n] = x[2] + ATTITUDE * random.standard_normal(flights)
        error = -ANGLE_GAIN * angles[n] - gyro
        integral = integral + RATE_GAIN / RATE_TIME * error * STEP
        controls[n] = RATE_GAIN * error + integral + injected[n]
        x[4] = controls[max(n - LATE, 0)]
        x = advance @ x
        x[3] += shaking * random.standard_normal(flights)
    return time[::LOGGED], controls[::LOGGED], angles[::LOGGED], injected[::LOGGED]


def identified(time, control, angle, injected, step, is_stated):
    """Return the fit of a flight whose log has such steps, deg, and states the hold or not."""
    logged = np.trunc(np.degrees(angle) / step) * step
    hold = {"u": STEP, "theta": 0.0, "injected": 0.0} if is_stated else {}
    signals = {"u": control, "theta": logged, "injected": injected}
    record = gb.Record(time, signals, {"theta": "deg"}, hold=hold)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return gb.identify(
            Recording({"log": record}),
            input="u=log.u",
            output="theta=log.theta",
            instrument="log.injected",
            structures=[DampedAngle()],
        ).fit


def row(name, fits):
    """Return the line of a cell."""
    estimate = np.array([[fit.estimate[p] for p in TRUTH] for fit in fits])
    quantities = [{q.name: q for q in fit.quantities} for fit in fits]
    total = np.array([[q[p].standard_error for p in TRUTH] for q in quantities])
    systematic = np.array([[q[p].systematic for p in TRUTH] for q in quantities])
    factor = np.array(
        [[(i[p][1] - i[p][0]) / 2 for p in TRUTH] for i in map(gb.Fit.interval, fits)]
    )
    away = np.abs(estimate - list(TRUTH.values()))
    scatter = np.sqrt(np.maximum(total**2 - systematic**2, 0)) / total
    held, without = (np.mean(away < w, axis=0) for w in (factor, factor * scatter))
    size, share = np.sqrt(np.mean((away / total) ** 2, axis=0)), np.median(systematic / total, 0)
    columns = [*(100 * held), *(100 * without)]
    return (
        f"{name:<26}"
        + "".join(f"{value:6.0f}" for value in columns)
        + "".join(f"{value:7.2f}" for value in (*size, *share))
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flights", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()

    lines = [
        f"greybox {gb.__version__}, {dt.date.today()}, Python {platform.python_version()}, numpy "
        f"{np.__version__}, {options.flights} flights a cell, seed {options.seed}",
        f"{'':<26}{'held, %: K a τ T':>24}{'scatter alone':>24}{'error/±':>28}{'systematic/±':>28}",
    ]
    print("\n".join(lines), flush=True)
    began = perf_counter()
    time, controls, angles, injected = flown(options.flights, options.seed)
    for name, (step, is_stated) in CELLS.items():
        fits = [
            identified(time, u, theta, injected, step, is_stated)
            for u, theta in zip(controls.T, angles.T, strict=True)
        ]
        lines.append(row(name, fits))
        print(lines[-1], flush=True)

    lines.append(f"{perf_counter() - began:.0f} s")
    print(lines[-1])
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
