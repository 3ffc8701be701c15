"""Virtual flights of a rate loop, in the layouts of Betaflight's blackbox and of PX4's logs."""

import numpy as np
from scipy.signal import cont2discrete

from greybox.data.record import Record, Recording

RATE = 500  # Hz
GAIN, LAG, LATE = 60.0, 0.03, 2  # angular acceleration, s, samples of delay


def loop(setpoint, gains=(0.5, 6.0), noise=0.0, feedforward=0.0, seed=0):
    """Return the terms P, I, F of the controller and the measured rate, GAIN / (s (LAG s + 1))."""
    dynamics = np.array([[0.0, GAIN], [0.0, -1 / LAG]]), np.array([[0.0], [1 / LAG]])
    a, b, *_ = cont2discrete((*dynamics, np.eye(2), np.zeros((2, 1))), 1 / RATE)
    errors = noise * np.random.default_rng(seed).standard_normal(setpoint.size)
    x, integral, queue, rows = np.zeros(2), 0.0, [0.0] * LATE, []
    for wanted, error in zip(setpoint, errors, strict=True):
        measured = x[0] + error
        integral += gains[1] * (wanted - measured) / RATE
        terms = (gains[0] * (wanted - measured), integral, feedforward * wanted)
        rows.append((*terms, measured))
        queue.append(sum(terms))
        x = a @ x + b[:, 0] * queue.pop(0)
    return np.array(rows).T


def blackbox(axis=1, seconds=12.0, states_axis=True, fine=False):
    """Return a table of Betaflight's blackbox with a chirp from 0.5 to 60 Hz on an axis."""
    time = np.arange(round((seconds + 2) * RATE)) / RATE - 1
    active = (time >= 0) & (time < seconds)
    growth = np.log(120) / seconds
    frequency = np.where(active, 0.5 * np.exp(growth * time), 0.0)
    phase = np.where(active, 2 * np.pi / growth * (frequency - 0.5), 0.0) % (2 * np.pi)
    chirp = np.where(active, np.cos(phase) * np.minimum(frequency, 1), 0)
    setpoint = 200 * chirp
    p, i, f, gyro = loop(setpoint, noise=1.0, feedforward=0.02)

    def of_axis(name, values):
        return {f"{name}[{k}]": values if k == axis else 0 * time for k in range(3)}

    scale = 10 if fine else 1
    debug = [5000 * phase]
    if states_axis:
        debug += [np.where(active, axis, -1), 10 * frequency, 1000 * chirp]
    columns = {
        "loopIteration": 2 * np.arange(time.size),
        "time" if fine else "time (us)": 1e6 * (time + 5),
        **of_axis("axisP", p),
        **of_axis("axisI", i),
        **of_axis("axisF", f),
        **of_axis("setpoint", scale * setpoint),
        **of_axis("gyroADC", scale * gyro),
        **{f"debug[{k}]": values for k, values in enumerate(debug)},
    }
    head = [f'"{name}"' if fine else name for name in columns]
    settings = '"Product","Blackbox"\n"blackbox_high_resolution","1"\n' if fine else ""
    rows = np.round(np.array(list(columns.values())).T).astype(int).tolist()
    return settings + "\n".join(",".join(map(str, row)) for row in [head, *rows]) + "\n"


def autotuning(seconds=15.0):
    """Return a PX4 log in which the autotuning moves the setpoint of the pitch rate in steps."""
    slow = np.arange(0, seconds + 4, 0.1)
    signs = np.sign(np.random.default_rng(1).standard_normal(slow.size // 3 + 1)).repeat(3)
    steps = np.where((slow >= 2) & (slow < 2 + seconds), 0.5 * signs[: slow.size], 0.0)
    time = np.arange(round(slow.size * RATE / 10)) / RATE
    setpoint = steps.repeat(RATE // 10)
    p, i, _, gyro = loop(setpoint, noise=0.002)
    held = {"hold": {"xyz[1]": np.inf}}
    return Recording(
        {
            "vehicle_torque_setpoint": Record(time, {"xyz[1]": p + i}, **held),
            "vehicle_angular_velocity": Record(time, {"xyz[1]": gyro}, {"xyz[1]": "rad/s"}),
            "vehicle_rates_setpoint": Record(time, {"pitch": setpoint}),
            "autotune_attitude_control_status": Record(
                slow, {"rate_sp[1]": steps}, hold={"rate_sp[1]": np.inf}
            ),
        },
        "flight.ulg",
    )
