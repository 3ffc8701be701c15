"""What loggers do to records: faults of samples are named, right ones left alone.

python benchmarks/damaged_records.py [--records 240] [--output FILE]

Jumps of a clock within a sweep are found where they matter; responses of records that have lost
rows have the errors that they state.

Second-order plants of random frequency and damping, driven in eight ways; outputs with noise from
none to a fifth, rounded by counters, texts and single precision.
"""

import argparse
import sys
from collections import Counter
from typing import TextIO

import numpy as np
from scipy.signal import butter, cont2discrete, freqz, lfilter

import greybox as gb
from greybox.data.files.arrays import Array
from greybox.data.signal_faults import signal_faults
from greybox.data.sweep_jump import sweep_jump

DRIVES = "noise sweep binary 3-2-1-1 sines levels rest limit".split()
DAMAGES = "held interpolated clipped far-off frozen alternating".split()


def driven(random: np.random.Generator, count: int, rate: float, drive: str) -> Array:
    """Return an input (n,)."""
    time = np.arange(count) / rate
    phases = random.uniform(0, 6, 8)
    octaves = (rate / 20 - 0.2) / (2 * time[-1])
    pulses = np.repeat([1.0, -1.0, 1.0, -1.0], np.array([3, 2, 1, 1]) * (count // 50))
    inputs = {
        "noise": lfilter(*butter(2, min(0.9, 16 / rate)), random.normal(size=count)),
        "sweep": np.sin(2 * np.pi * (0.2 * time + octaves * time**2)),
        "binary": np.repeat(random.choice([-1.0, 1.0], count // 10 + 1), 10)[:count],
        "3-2-1-1": np.pad(pulses, (count // 10, count))[:count],
        "sines": sum(np.sin(1.9 * k * time + phase) for k, phase in enumerate(phases, start=1)),
        "levels": np.repeat(random.normal(size=count // 20 + 1), 20)[:count],
        "rest": np.where(np.abs(time / time[-1] - 0.5) < 0.1, np.sin(5 * time), 0.0),
        "limit": np.clip(1.3 * np.sin(3 * time) + 0.3 * random.normal(size=count), -1, 1),
    }
    return inputs[drive]


def plant(random: np.random.Generator, rate: float, hold: str) -> tuple[Array, Array]:
    """Return a second-order lag as a filter, numerator and denominator."""
    w, damping = random.uniform(2, 15), random.uniform(0.2, 1)
    discrete = cont2discrete(([w * w], [1, 2 * damping * w, w * w]), 1 / rate, hold)
    return discrete[0].ravel(), discrete[1]


def right_record(random: np.random.Generator, drive: str) -> tuple[Array, Array]:
    """Return input and output as a good logger has them."""
    count, rate = int(random.choice([800, 3000, 6000])), float(random.choice([50, 100, 400]))
    u = driven(random, count, rate, drive)
    y = lfilter(*plant(random, rate, "zoh"), u)
    y = y + random.choice([0, 0.001, 0.02, 0.2]) * np.std(y) * random.normal(size=count)
    step = random.choice([0, 0, 1e-3, 0.02]) * np.ptp(y)
    y = np.round(y / step) * step if step else y
    if random.random() < 0.3:
        u, y = (x.astype(np.float32).astype(float) for x in (u, y))
    if random.random() < 0.3:
        u, y = np.round(u, 4), np.round(y, 4)
    return u, y


def damaged(y: Array, damage: str) -> Array:
    """Return an output (n,) as a bad logger has it."""
    rows, result = np.arange(y.size), y.copy()
    match damage:
        case "held":
            return y[(np.floor(rows / 5.3) * 5.3).astype(int)]
        case "interpolated":
            return np.interp(rows, rows[::5], y[::5])
        case "clipped":
            return np.clip(y, -0.5 * np.abs(y).max(), 0.5 * np.abs(y).max())
        case "far-off":
            result[y.size // 2] = 10 * np.abs(y).max()
        case "frozen":
            result[2000:2300] = result[2000]
        case _:
            result[::2] += 2 * np.std(y)
    return result


def faults(records: int, output: TextIO) -> None:
    """Print how many right signals are accused, and how many damaged ones are not."""
    random = np.random.default_rng(1)
    accused = Counter[str]()
    for k in range(records):
        u, y = right_record(random, DRIVES[k % len(DRIVES)])
        pairs = ((u, y, True), (y, u, False))
        for values, other, is_command in pairs:
            for fault in signal_faults("x", values, other[None], is_command=is_command):
                accused[f"{DRIVES[k % len(DRIVES)]}, {fault.kind}"] += 1
    print(f"right signals: {2 * records}, accused {accused.total()} {dict(accused)}", file=output)

    seen = Counter[str]()
    for k in range(records):
        u = driven(random, 6000, 100.0, DRIVES[k % 2])
        y = lfilter(*plant(random, 100.0, "foh"), u)
        y = y + random.choice([0.001, 0.02, 0.1]) * np.std(y) * random.normal(size=y.size)
        for damage in DAMAGES:
            found = signal_faults("y", damaged(y, damage), u[None])
            seen[damage] += [fault.kind for fault in found] == [damage.replace("-", " ")]
    for damage in DAMAGES:
        print(f"{damage}: {seen[damage]} of {records} named", file=output)


def sweep(random: np.random.Generator, count: int, rate: float) -> tuple[Array, Array]:
    """Return a linear or a logarithmic sweep (n,), and its frequency (n,) in rad/s."""
    share, duration = np.arange(count) / count, count / rate
    low, high = random.uniform(0.3, 1.5), random.uniform(10, 30)
    is_linear = random.random() < 0.5
    omega = low + (high - low) * share if is_linear else low * (high / low) ** share
    return np.sin(np.cumsum(omega) * duration / count), omega


def gusts(random: np.random.Generator, count: int) -> Array:
    """Return slow noise (n,) of deviation 1."""
    wind = lfilter(*butter(1, random.uniform(0.01, 0.1)), random.normal(size=count))
    return wind / np.std(wind)


def jumps(records: int, output: TextIO) -> None:
    """Print in how many sweeps a jump of the clock is found, and in how many right ones."""
    random = np.random.default_rng(2)
    print(
        "\njumps of a clock by 20 to 100 ms within a sweep: found at the right place", file=output
    )
    count, rate = 6000, 100.0
    for case in ("noise .1 %", "noise 2 %", "noise 5 %", "gusts", "stiffening", "dead zone"):
        accused, angles, found = 0, [], []
        for _ in range(records // 3):
            u, omega = sweep(random, count, rate)
            force = u if case != "dead zone" else u - np.clip(u, -0.2, 0.2)
            y = lfilter(*plant(random, rate, "foh"), force)
            if case == "stiffening":
                y = y + 0.4 * y * np.abs(y) / np.std(y)
            if case == "gusts":
                y = y + random.uniform(0.1, 1) * np.std(y) * gusts(random, count)
            noise = {"noise 2 %": 0.02, "noise 5 %": 0.05}.get(case, 0.001)
            y = y + noise * np.std(y) * random.normal(size=count)
            accused += sweep_jump(u, y) is not None

            rows, begin = (
                int(random.choice([-10, -5, -2, 2, 5, 10])),
                int(random.uniform(1200, 4800)),
            )
            late = np.r_[y[:begin], np.roll(y, rows)[begin:-10]]
            jump = sweep_jump(u[: late.size], late)
            angles.append(abs(rows) * omega[begin] / rate)
            found.append(jump is not None and abs(jump.row - begin) < 100)
        by_angle = []
        for low, high in ((0, 0.1), (0.1, 0.3), (0.3, 10)):
            within = [hit for hit, angle in zip(found, angles, strict=True) if low < angle <= high]
            by_angle.append(
                f"{sum(within):2} of {len(within):2} that turn it by {low} to {high} rad"
            )
        print(
            f"{case:10}  {', '.join(by_angle)}; right ones accused: {accused} of {records // 3}",
            file=output,
        )


def lost_rows(output: TextIO) -> None:
    """Print the errors of responses of 12 000 samples that have lost rows at random."""
    print(
        "\nlost rows: points, median error, its root mean square over the stated one", file=output
    )
    for drive, hold in (("noise", "foh"), ("sweep", "foh"), ("noise", "zoh"), ("levels", "zoh")):
        for share in (0.0, 0.01, 0.05, 0.1):
            points, errors, ratios = [], [], []
            for seed in range(6):
                random = np.random.default_rng(seed)
                u = driven(random, 12000, 100.0, drive)
                numerator, denominator = plant(random, 100.0, hold)
                y = lfilter(numerator, denominator, u)
                y = y + 0.01 * np.std(y) * random.normal(size=y.size)
                keep = random.random(y.size) >= share
                keep[[0, -1]] = True
                signals = {"u": u[keep], "y": y[keep]}
                held = {"u": np.inf if hold == "zoh" else 0.0}
                record = gb.Record((np.arange(y.size) / 100)[keep], signals, hold=held)
                response = gb.spectral.spectral_response(record, "u", "y")
                exact = freqz(numerator, denominator, response.omega / 100)[1]
                error = np.abs(response.response - exact)
                points.append(len(response))
                errors.append(np.median(error / np.abs(exact)))
                ratios.append(np.sqrt(np.median(error**2 / response.variance)))
            print(
                f"{drive:7} {hold}  {100 * share:3.0f} %  {np.mean(points):5.0f}  "
                f"{100 * np.mean(errors):5.2f} %  {np.mean(ratios):4.2f}",
                file=output,
            )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--records", type=int, default=240)
    parser.add_argument("--output", type=argparse.FileType("w"), default=sys.stdout)
    options = parser.parse_args()
    faults(options.records, options.output)
    jumps(options.records, options.output)
    lost_rows(options.output)


if __name__ == "__main__":
    main()
