"""Sines with a known complex amplitude, and sampling that is not uniform."""

import numpy as np

from greybox.data.spectral.demodulation import least_squares, whole_periods


def sine(t, omega, amplitude):
    """What `amplitude` = alpha + j beta stands for."""
    return amplitude.real * np.sin(omega * t) + amplitude.imag * np.cos(omega * t)


def irregular(seed, duration, rate=80):
    """Times of a mean rate whose steps vary by 0.3 to 1.7."""
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.uniform(0.3, 1.7, int(duration * rate)) / rate)


def amplitude(t, values, omega, settle=0.0):
    """The complex amplitude of a signal over its last whole periods."""
    rows, _ = whole_periods(t, omega, settle)
    return least_squares(t[rows], values[None, rows], omega, t[0], 1)[0][0, 0]
