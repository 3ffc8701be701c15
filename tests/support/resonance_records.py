"""A resonance in discrete time, records of what it does, and how often intervals hold the truth."""

import math

import numpy as np
from scipy.signal import cont2discrete
from scipy.stats import t as student

from greybox.data.record import Record
from greybox.workflows.experiment.sweeps import sweep

HZ = 2 * math.pi
RATE = 50


def resonance(natural=6.0, damping=0.3, rate=RATE):
    b, a, _ = cont2discrete(([natural**2], [1, 2 * damping * natural, natural**2]), 1 / rate)
    return b.ravel(), a


def record(rate=RATE, **signals):
    n = len(next(iter(signals.values())))
    return Record(np.arange(n) / rate, signals)


def flown_sweep(rate=RATE, duration=60.0, amplitude=1.0):
    made = sweep(HZ * 0.1, HZ * 6, duration, rate, amplitude=amplitude)["u"]
    return np.concatenate([np.zeros(3 * rate), made, np.zeros(3 * rate)])


def covered(response, truth):
    """Which 95 % intervals, of both components, hold the truth, by Student's t."""
    half = student.ppf(0.975, response.dof) * np.sqrt(response.variance / 2)
    error = response.response - truth
    return np.array([np.abs(error.real) < half, np.abs(error.imag) < half])
