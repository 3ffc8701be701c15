"""From a sweep in closed loop to an interval.

Points and parameters of `gb.identify` against the truth. Monte Carlo.

python benchmarks/identify_coverage.py [--repeats 60] [--only setpoint] [--out FILE]

A quadcopter's pitch, K / ((τ s + 1) s (s + a)), is flown by an angle and rate controller at 400 Hz,
with gusts on the angular acceleration and noise of the gyro. A logarithmic sweep is injected behind
the controller or into its setpoint, and the log has every pass, every second or fewer. All flights
of a cell are simulated at once.

Printed: points of a response; the root mean square of their errors over their standard errors, of
all and of the worst flight; per parameter the share of 95 % intervals that hold the truth, and the
root mean square and the mean of the errors over the standard errors.
"""

import argparse
import datetime as dt
import platform
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np

import greybox as gb
from greybox.data.record import Recording
from greybox.models.rate import DampedAngle

K, A, TAU = 91.0, 0.681, 0.05  # 1/s², 1/s, s
STEP = 1 / 800  # s, of the simulation; the controller runs at every second
REST = 8.0  # s before and after the sweep
ANGLE, RATE_P, RATE_I, RATE_D, FILTER = (
    4.5,
    0.135,
    0.135,
    0.0036,
    20.0,
)  # gains of ArduPilot, and Hz of the D term
GYRO, ATTITUDE = 0.003, 0.0002  # noise, rad/s and rad


class Cell(NamedTuple):
    """Gusts in rad/s², rate of the log in Hz, sweep in s and Hz, amplitude, injection."""

    gust: float
    logged: int
    duration: float
    band: tuple[float, float]
    amplitude: float
    where: str = "mixer"


CELLS = {
    "calm, 200 Hz": Cell(0.1, 200, 60, (0.1, 6), 0.06),
    "calm, 400 Hz, 30 s": Cell(0.1, 400, 30, (0.2, 8), 0.06),
    "gusts, 200 Hz": Cell(0.5, 200, 60, (0.1, 6), 0.06),
    "gusts, 100 Hz": Cell(0.5, 100, 60, (0.1, 6), 0.06),
    "gusts, 100 Hz, to 40 Hz": Cell(0.5, 100, 60, (0.1, 40), 0.06),
    "strong gusts, 200 Hz": Cell(1.5, 200, 60, (0.1, 6), 0.06),
    "gusts, setpoint, 200 Hz": Cell(0.5, 200, 60, (0.1, 3), 0.05, "setpoint"),
    "gusts, setpoint, 50 Hz, 90 s": Cell(0.5, 50, 90, (0.05, 5), 0.08, "setpoint"),
}


def sweep(cell, time):
    """Return the injected signal, with two seconds of fading at either end."""
    low, high = cell.band
    t = np.clip(time - REST, 0, cell.duration)
    growth = np.log(high / low)
    phase = 2 * np.pi * low * cell.duration / growth * np.expm1(growth * t / cell.duration)
    return cell.amplitude * np.clip(np.minimum(t, cell.duration - t) / 2, 0, 1) * np.sin(phase)


def flown(cell, flights, seed):
    """Return time (n,), control and angle (n, flights), and injected signal (n,), as logged."""
    random = np.random.default_rng(seed)
    steps = round((cell.duration + 2 * REST) / STEP)
    injected = sweep(cell, STEP * np.arange(steps))
    moment, rate, angle, control, gust, before, slope, integral = np.zeros((8, flights))
    decay, lag, smoothing = (
        np.exp(-STEP / 1.0),
        -np.expm1(-STEP / TAU),
        -np.expm1(-2 * np.pi * FILTER * 2 * STEP),
    )
    rows = []
    for n in range(steps):
        if n % 2 == 0:
            gyro = rate + GYRO * random.standard_normal(flights)
            attitude = angle + ATTITUDE * random.standard_normal(flights)
            setpoint = injected[n] if cell.where == "setpoint" else 0.0
            error = ANGLE * (setpoint - attitude) - gyro
            integral = integral + RATE_I * error * 2 * STEP
            slope = slope + smoothing * ((gyro - before) / (2 * STEP) - slope)
            before = gyro
            control = RATE_P * error + integral - RATE_D * slope
            if cell.where == "mixer":
                control = control + injected[n]
            if n % round(1 / (STEP * cell.logged)) == 0:
                rows.append((n, control, attitude))
        gust = decay * gust + np.sqrt(1 - decay**2) * cell.gust * random.standard_normal(flights)
        moment = moment + lag * (control - moment)
        rate = rate + STEP * (
            K * moment - A * rate + gust + 2 * cell.gust * random.standard_normal(flights)
        )
        angle = angle + STEP * rate
    at, controls, angles = (np.array(column) for column in zip(*rows, strict=True))
    return STEP * at, controls, angles, injected[at]


def plant(omega):
    """Return the response of the simulated plant from the held control to the angle."""
    s = 1j * omega
    z, lag = np.exp(s * STEP), -np.expm1(-STEP / TAU)
    moment = K * lag / (z - 1 + lag)
    return z * STEP / (z - 1) * z * STEP / (z - 1 + STEP * A) * moment * (1 + 1 / z) / 2


def measured(cell, flights, seed):
    """Return numbers and mean squared errors of points (flights,), standardized errors (n, 3)."""
    time, controls, angles, injected = flown(cell, flights, seed)
    name, size = ("desired", np.degrees(1)) if cell.where == "setpoint" else ("injected", 1.0)
    points, squares, errors, held = [], [], [], []
    for u, theta in zip(controls.T, angles.T, strict=True):
        signals = {"u": u, "theta": np.degrees(theta), name: size * injected}
        record = gb.Record(
            time, signals, {"theta": "deg", **({"desired": "deg"} if name == "desired" else {})}
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = gb.identify(
                Recording({"log": record}),
                input="u=log.u",
                output="theta=log.theta",
                instrument=f"log.{name}",
                structures=[DampedAngle()],
            )
        response = found.measurement.response
        points.append(len(response))
        squares.append(
            np.mean(np.abs(response.response - plant(response.omega)) ** 2 / response.variance)
        )
        truth = {"K_phi": K, "a": A, "T_rotor": TAU}
        inside = found.fit.interval()
        errors.append(
            [
                (found.fit.estimate[p] - v) / found.fit.standard_error.get(p, np.nan)
                for p, v in truth.items()
            ]
        )
        held.append([p in inside and inside[p][0] <= v <= inside[p][1] for p, v in truth.items()])
    return np.array(points), np.array(squares), np.array(errors), np.array(held)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="")
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    about = (
        f"greybox {version('greybox-id')}, Python {platform.python_version()}, numpy "
        f"{np.__version__}"
    )
    lines = [
        f"{asked.repeats} flights a cell, seed {asked.seed}; {about}, {dt.date.today()}",
        f"{'':30} points   rms (worst)   held, %: K a τ       rms of error / standard error   mean",
    ]
    print(*lines, sep="\n", flush=True)
    for name, cell in CELLS.items():
        if asked.only not in name:
            continue
        points, squares, errors, held = measured(cell, asked.repeats, asked.seed)
        rms, mean = np.sqrt(np.nanmean(errors**2, axis=0)), np.nanmean(errors, axis=0)
        lines.append(
            f"{name:30} {points.mean():6.1f}   {np.sqrt(squares.mean()):.2f} "
            f"({np.sqrt(squares.max()):.2f})   "
            + " ".join(f"{100 * share:5.1f}" for share in held.mean(axis=0))
            + "        "
            + " ".join(f"{value:5.2f}" for value in rms)
            + "        "
            + " ".join(f"{value:+5.2f}" for value in mean)
        )
        print(lines[-1], flush=True)
    if asked.out:
        asked.out.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
