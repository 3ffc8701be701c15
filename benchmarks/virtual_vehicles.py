"""Virtual multirotors of known parameters, flown in closed loop, identified from their logs.

python benchmarks/virtual_vehicles.py [VEHICLES] [--first SEED] [--output FILE]

Every vehicle has 4, 6 or 8 rotors, .03 to 10 kg, rotor lags of .013 to .08 s, drag, gusts of force
and moment that last longer than a sample, noise of gyroscope and accelerometer, and a controller of
rates with a filter of the gyroscope. NumPy flies it at 1 kHz with equations of its own, and its log
has the form of a Crazyflie's, with rounded commands. All parameters of the stages `rotors`, `roll
and pitch`, `at once` and `yaw` are compared with the truth, and with a plain regression of
angular acceleration on thrust, which takes feedback for an effect of the commands.
"""

import argparse
import datetime as dt
import time
from pathlib import Path

import numpy as np

import greybox as gb
from greybox.data.record import Recording
from greybox.models.multirotor import Multirotor, regular_frame
from greybox.workflows.identification.stages import fit_in_stages

STEP, SECONDS = 1e-3, 24.0  # s
COMPARED = (
    "T_rotor",
    "c_2",
    "a5_z",
    "F_max",
    "T_delay",
    "j_x",
    "j_y",
    "k_m",
    "h",
    "J_x",
    "J_y",
    "J_z",
)


def vehicle(seed):
    """Return the rotors and the true values of a vehicle."""
    random = np.random.default_rng(seed)
    mass = 0.03 * (10 / 0.03) ** random.uniform()
    arm = 0.046 * (mass / 0.03) ** 0.35 * random.uniform(0.8, 1.2)
    rotors = regular_frame(int(random.choice([4, 6, 8])), round(float(arm), 4))
    hover = random.uniform(0.4, 0.6)
    share = gb.g / len(rotors)
    c_1 = random.uniform(-0.1, 0.3) * share / hover
    s_z = random.normal(0.93, 0.04)
    truth = {
        "m": mass,
        "T_rotor": 0.01 * 10 ** random.uniform(0.1, 0.9),
        "T_delay": STEP * random.integers(2, 11),
        "c_0": 0.0,
        "c_1": c_1,
        "c_2": (share - c_1 * hover) / hover**2,
        "j_x": arm**2 * random.uniform(0.12, 0.25),
        "k_m": arm * random.uniform(0.1, 0.2) * random.choice([-1, 1]),
        "s_z": min(s_z, 1.0),
        "a5_z": random.uniform(0.0, 0.5),
        "hover": hover,
    }
    truth["j_y"] = truth["j_x"] * random.uniform(0.9, 1.3)
    truth["h"] = truth["k_m"] * share / hover * random.uniform(0.0, 0.03)
    truth |= {f"J_{k}": mass * truth[f"j_{k}"] for k in "xy"}
    truth["J_z"] = mass * truth["s_z"] * (truth["j_x"] + truth["j_y"])
    truth["F_max"] = mass * (truth["c_1"] + truth["c_2"])
    return rotors, truth


def flight(rotors, truth, seed):
    """Return the log of a flight in closed loop, as a card logger writes it."""
    random = np.random.default_rng([seed, 1])
    x, y, d = np.transpose(rotors)
    j = np.array([truth["j_x"], truth["j_y"], truth["s_z"] * (truth["j_x"] + truth["j_y"])])
    slope = truth["c_1"] + 2 * truth["c_2"] * truth["hover"]
    # Commands of the axes that move the rotors by their signs, and the accelerations they cause.
    signs = np.array([np.sign(y), -np.sign(x), -d * np.sign(truth["k_m"])])
    authority = slope * np.array([np.abs(y).sum(), np.abs(x).sum(), len(x) * abs(truth["k_m"])]) / j
    speed = 0.35 / (truth["T_rotor"] + truth["T_delay"] + 0.004)  # rad/s, crossover of the loop
    count = round(SECONDS / STEP)
    late = round(truth["T_delay"] / STEP)
    wanted = doublets(random, count)
    levels = random.uniform(-0.35, 0.35, round(SECONDS / 0.4) + 1)
    collective = truth["hover"] * (1 + np.repeat(levels, 400)[:count])

    w, omega, angle, force = np.full(len(x), truth["hover"]), np.zeros(3), np.zeros(3), 0.0
    gust, climb, filtered, integral = np.zeros(3), 0.0, np.zeros(3), np.zeros(3)
    commands, rates, felt = (np.zeros((n, count)) for n in (len(x), 3, 3))
    weather = random.uniform(0.02, 0.1) * authority * 0.1  # rad/s², standard deviation
    noise = random.uniform(0.002, 0.01)  # rad/s, of the gyroscope
    for k in range(count):
        gust += (-gust / 0.3) * STEP + weather * np.sqrt(2 / 0.3 * STEP) * random.normal(size=3)
        force += (-force / 0.5) * STEP + 0.15 * np.sqrt(2 / 0.5 * STEP) * random.normal()
        measured = omega + noise * random.normal(size=3)
        filtered += (measured - filtered) * STEP / 0.003
        error = wanted[:, k] - 3.0 * angle * [1, 1, 0] - filtered
        integral += error * STEP
        control = speed * (error + 0.3 * speed * integral) / authority
        sent = np.clip(collective[k] - 0.02 * climb + control @ signs, 0, 1)
        commands[:, k] = np.round(sent * 65535) / 65535
        rates[:, k] = measured
        rising = (commands[:, max(k - late, 0)] - w) / truth["T_rotor"]
        # The mean of both ends: with the speed at the beginning, the air would be half a step late.
        later = w + rising * truth["T_rotor"] * (1 - np.exp(-STEP / truth["T_rotor"]))
        middle = (w + later) / 2
        f = truth["c_1"] * middle + truth["c_2"] * middle**2
        torque = np.array([y @ f, -x @ f, -d @ (truth["k_m"] * f + truth["h"] * rising)])
        f = truth["c_1"] * w + truth["c_2"] * w**2
        turning = (torque - np.cross(omega, j * omega)) / j + gust
        lift = f.sum() + force - truth["a5_z"] * climb
        felt[:, k] = [0.0, 0.0, lift]
        felt[:, k] += 0.4 * random.normal(size=3)
        w = later
        omega = omega + turning * STEP
        angle = angle + omega * STEP
        climb += (lift - gb.g) * STEP
    signals = {f"motor.m{k + 1}": 65535 * row for k, row in enumerate(commands)}
    signals |= {f"gyro.{k}": np.degrees(row) for k, row in zip("xyz", rates, strict=True)}
    signals |= {f"acc.{k}": row / gb.g for k, row in zip("xyz", felt, strict=True)}
    units = {name: "deg/s" if name.startswith("gyro") else "9.80665 m/s²" for name in signals}
    units |= {name: "" for name in signals if name.startswith("motor")}
    record = gb.Record(STEP * np.arange(count), signals, units=units)
    return Recording({"fixedFrequency": record}, f"vehicle {seed}")


def doublets(random, count):
    """Return wanted rates of roll, pitch and yaw: doublets at random times, rad/s."""
    wanted = np.zeros((3, count))
    for axis, size in enumerate((1.2, 1.2, 0.6)):
        at = 0.5
        while at < SECONDS - 1.5:
            half = random.uniform(0.1, 0.4)
            height = random.choice([-1, 1]) * size * random.uniform(0.5, 1.5)
            for start, sign in ((at, 1), (at + half, -1)):
                wanted[axis, round(start / STEP) : round((start + half) / STEP)] += sign * height
            at += 2 * half + random.uniform(0.0, 0.8)
    return wanted


def regression(rotors, log, truth):
    """Return j_x and j_y by least squares of the angular acceleration on the true lagged thrust."""
    record = log["fixedFrequency"]
    x, y, _ = np.transpose(rotors)
    u = np.array([record[f"motor.m{k + 1}"] for k in range(len(rotors))]) / 65535
    decay = np.exp(-STEP / truth["T_rotor"])
    w = np.zeros_like(u)
    w[:, 0] = truth["hover"]
    for k in range(1, u.shape[1]):
        w[:, k] = decay * w[:, k - 1] + (1 - decay) * u[:, k - 1]
    f = truth["c_1"] * w + truth["c_2"] * w**2
    kernel = np.hanning(61) / np.hanning(61).sum()
    result = {}
    for name, moment, rate in (("j_x", y @ f, "gyro.x"), ("j_y", -x @ f, "gyro.y")):
        smooth = np.convolve(np.radians(record[rate]), kernel, "same")
        turning = np.gradient(smooth, STEP)[100:-100]
        A = np.column_stack([np.convolve(moment, kernel, "same"), np.ones(moment.size)])[100:-100]
        result[name] = 1 / np.linalg.lstsq(A, turning, rcond=None)[0][0]
    return result


def judged(seed):
    """Return the lines of a vehicle, and inside and outside counts by stage."""
    rotors, truth = vehicle(seed)
    log = flight(rotors, truth, seed)
    begin = time.process_time()
    found = fit_in_stages(Multirotor(rotors), [log], {"fixed": {"m": truth["m"]}})
    seconds = time.process_time() - begin
    plain = regression(rotors, log, truth)
    label = f"{len(rotors)} rotors, {truth['m']:.3g} kg, T {truth['T_rotor']:.3f} s"
    lines = [f"vehicle {seed}: {label}; {seconds:.0f} s of processor"]
    counts = {}
    for stage, fit in found.fits.items():
        inside = total = 0
        cells = []
        intervals = fit.interval() if fit.converged else {}
        for name in COMPARED:
            quantity = next((q for q in fit.quantities if q.name == name), None)
            # What a stage holds without an error of its own is no estimate.
            if quantity is None or name not in intervals or not quantity.standard_error:
                continue
            low, high = intervals[name]
            covers = bool(low <= truth[name] <= high)
            inside, total = inside + covers, total + 1
            off = (quantity.value - truth[name]) / quantity.standard_error
            relative = quantity.standard_error / abs(truth[name])
            cells.append(f"{name} {off:+.1f}σ ({100 * relative:.1f} %){'' if covers else ' OUT'}")
        counts[stage] = (inside, total)
        verdict = str(fit).splitlines()[2].strip().split(":")[0]
        lines.append(f"  {stage}: {inside} of {total}; {verdict}; {', '.join(cells)}")
    off = ", ".join(f"{k} {100 * (v / truth[k] - 1):+.1f} %" for k, v in plain.items())
    lines.append(f"  plain regression with the true rotor: {off}")
    return lines, counts


def main():
    """Print every vehicle, and the shares of intervals that hold."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("vehicles", nargs="?", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines, totals = [f"greybox {gb.__version__}, {dt.date.today()}"], {}
    for seed in range(options.first, options.first + options.vehicles):
        own, counts = judged(seed)
        for stage, (inside, total) in counts.items():
            before = totals.get(stage, (0, 0))
            totals[stage] = (before[0] + inside, before[1] + total)
        print("\n".join(own), flush=True)
        lines += own
    for stage, (inside, total) in totals.items():
        share = 100 * inside / max(total, 1)
        lines.append(f"{stage}: {inside} of {total} intervals hold the truth, {share:.0f} %")
    print("\n".join(lines[-len(totals) :]))
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
