"""The period of a signal is found, and a signal that does not repeat itself has none."""

import numpy as np
import pytest
from scipy.signal import lfilter, max_len_seq

from greybox.data.repetition import period_of

COUNT = 6000


def multisine(random, period):
    rows = np.arange(COUNT)
    lines = np.unique(np.rint(np.geomspace(1, period / 20, 12)))
    phases = random.uniform(0, 6, lines.size)
    return np.sin(2 * np.pi * rows[:, None] * lines / period + phases).sum(axis=1)


@pytest.mark.parametrize("period", [200, 731.3, 1000, 2500])
def test_the_period_of_a_multisine(period):
    for seed in range(4):
        random = np.random.default_rng(seed)
        u = multisine(random, period)
        u += 0.05 * np.std(u) * random.normal(size=COUNT)
        assert period_of(u) == pytest.approx(period, abs=1)


def test_the_period_of_a_binary_sequence():
    bits = np.repeat(2.0 * max_len_seq(7)[0] - 1, 5)
    assert period_of(np.resize(bits, COUNT)) == bits.size


def test_what_does_not_repeat_itself_has_no_period():
    random = np.random.default_rng(1)
    time = np.arange(COUNT) / 100
    signals = [
        random.normal(size=COUNT),
        lfilter([0.01], [1, -0.99], random.normal(size=COUNT)),
        np.sin(2 * np.pi * (0.2 * time + 0.03 * time**2)),
        np.repeat(random.choice([-1.0, 1.0], COUNT // 10), 10),
        np.where((time > 10) & (time < 12), 1.0, 0.0),
        time,
    ]
    assert np.isnan([period_of(signal) for signal in signals]).all()
