"""The test of misfit on long records: a spring logged at 200 Hz to 1 kHz, 12 000 to 30 000 samples.

    python benchmarks/long_records.py [seeds]

Steps of random size and length drive it, from outside or through a controller; one or both states
are measured with errors of 3 %, white or correlated over 50 ms. For every kind of defect: how many
fits say that the model does not explain the data, and how many have the cause among the first two.
"""

import os
import re
import sys
import time

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from scipy.signal import lfilter

import greybox as gb

STIFFNESS, DAMPING, GAIN, DELAY, LAG = 3.0, 0.8, 4.0, 0.06, 0.08
STEPS, COUNTS = (0.001, 0.002, 0.005), (12_000, 20_000, 30_000)
# What is left out of the model, with what may be said of it.
DEFECTS = {
    "none": "",
    "y**3": r"y\*\*3|abs\(y\) \* y|sign\(y\)",
    "abs(v) v": r"abs\(v\) \* v|v\*\*3",
    "dry friction": r"sign\(v\)",
    "delay": "delay|lag|late",
    "lag": "lag|delay|late",
    "saturation": "saturation",
}


class Spring(gb.StateSpace):
    """A spring with a damper, pushed by u."""

    states, inputs, outputs = ("v", "y"), ("u",), ("y",)
    k = gb.Parameter(2.0, bounds=(0.1, 40))
    c = gb.Parameter(1.0, bounds=(0.05, 20))
    g = gb.Parameter(3.0, bounds=(0.1, 40))

    def derivative(self, x, u, p):
        """Return the acceleration and the speed."""
        return (p.g * u.u - p.k * x.y - p.c * x.v, x.v)

    def output(self, x, u, p):
        """Return what is measured."""
        return [x[name] for name in self.outputs]


class SpringWithSpeed(Spring):
    """Its speed is measured, too."""

    outputs = ("v", "y")


def simulated(defect, reference, step, errors, is_controlled):
    """Return inputs (n,) and outputs (2, n), by Euler steps of at most 0.25 ms."""
    speed = place = slow = 0.0
    inputs, outputs = np.zeros(len(reference)), np.zeros((2, len(reference)))
    late = [0.0] * round(DELAY / step)
    substeps = max(1, round(step / 0.00025))  # steps of 2 ms would be seen
    for i, wanted in enumerate(reference):
        outputs[:, i] = speed, place
        push = 1.5 * (wanted - place - errors[i]) if is_controlled else wanted
        inputs[i] = push
        if defect == "delay":
            late.append(push)
            push = late.pop(0)
        if defect == "saturation":
            push = np.clip(push, -0.6, 0.6)
        for _ in range(substeps):
            slow += step / substeps * (push - slow) / LAG
            force = GAIN * (slow if defect == "lag" else push) - STIFFNESS * place - DAMPING * speed
            force -= {
                "y**3": 1.2 * place**3,
                "abs(v) v": 0.6 * abs(speed) * speed,
                "dry friction": 0.25 * np.tanh(speed / 0.01),
            }.get(defect, 0.0)
            speed += step / substeps * force
            place += step / substeps * speed
    return inputs, outputs


def record(seed, defect):
    """Return a model and a record of a spring with this defect."""
    random = np.random.default_rng([seed, len(defect)])
    step, count = STEPS[seed % 3], COUNTS[seed // 3 % 3]
    hold = int(random.uniform(0.4, 2.5) / step)
    reference = np.repeat(random.uniform(-1.2, 1.2, count // hold + 1), hold)[:count]
    errors = random.normal(size=(2, count))
    if seed % 2:
        pole = np.exp(-step / 0.05)
        errors = lfilter([np.sqrt(1 - pole**2)], [1, -pole], errors, axis=1)
    _, exact = simulated(defect, reference, step, np.zeros(count), is_controlled=False)
    errors *= 0.03 * exact.std(axis=1)[:, None]
    inputs, outputs = simulated(defect, reference, step, errors[1], is_controlled=seed // 4 % 2)
    model = (SpringWithSpeed if seed // 2 % 2 else Spring)()
    measured = dict(zip(("v", "y"), outputs + errors, strict=True))
    signals = {"u": inputs} | {name: measured[name] for name in model.outputs}
    return model, gb.Record(step * np.arange(count), signals, hold={"u": np.inf})


if __name__ == "__main__":
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 8
    print(f"greybox {gb.__version__}, numpy {np.__version__}, {seeds} records of each kind")
    for defect, pattern in DEFECTS.items():
        called = right = 0
        began = time.process_time()
        for seed in range(seeds):
            fit = gb.fit(gb.Problem(*record(seed, defect)), 2, progress=False, profiles=False)
            called += not fit.misfit.explains
            causes = [cause.text for cause in fit.misfit.likely[:2]]
            right += bool(pattern and re.search(pattern, " ".join(causes)))
        seconds = (time.process_time() - began) / seeds
        print(
            f"{defect}: {called} called, {right} by the right cause, "
            f"{seconds:.1f} s each with its record",
            flush=True,
        )
