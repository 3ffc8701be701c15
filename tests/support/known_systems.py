"""Transfer functions with known parameters, records of them, and maximum likelihood of their
responses by scipy."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import butter, lfilter, sosfilt

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record

HZ = 2 * math.pi


class System(NamedTuple):
    response: Callable
    truth: np.ndarray


def _second_order(s, p):
    return (p[0] * s + p[1]) / (s**2 + p[2] * s + p[3]) * np.exp(-s * p[4])


def _mode(s, p):
    return p[0] * p[1] ** 2 / (s**2 + 2 * p[2] * p[1] * s + p[1] ** 2) * np.exp(-s * p[3])


def _lag(s, p):
    return p[0] / (p[1] * s + 1) * np.exp(-s * p[2])


def _notch(s, p):
    return (
        p[0] * (s**2 + 2 * p[1] * p[2] * s + p[2] ** 2) / (s**2 + 2 * p[3] * p[4] * s + p[4] ** 2)
    )


EXAMPLE = System(_second_order, np.array([0.4, 0.1, 0.9, 2.0, 0.2]))
MODE = System(_mode, np.array([1.0, 3.0, 0.08, 0.05]))
LIGHT = System(_mode, np.array([1.0, 3.0, 0.03, 0.05]))
LAG = System(_lag, np.array([2.0, 0.5, 0.1]))
NOTCH = System(_notch, np.array([1.0, 0.1, 2.0, 0.3, 5.0]))


def excitation(kind, time, rng):
    """Return a test signal: sweeps from 0.02 or 0.05 to 2 Hz, or noise from 0.05 to 1.5 Hz."""
    duration = time[-1]
    if kind == "logarithmic":
        rise = math.log(100)
        return np.sin(HZ * 0.02 * duration / rise * np.expm1(rise * time / duration))
    if kind == "linear":
        return np.sin(HZ * (0.05 * time + 1.95 * time**2 / 2 / duration))
    if (
        kind == "cifer"
    ):  # Tischler and Remple, 2nd ed., equation (5.5): 3 s of trim and 5 s of fading at either end
        inside = np.clip(time - 3, 0, duration - 6)
        span = duration - 6
        phase = HZ * 0.02 * inside + 0.0187 * HZ * 1.98 * (
            span / 4 * np.expm1(4 * inside / span) - inside
        )
        return np.sin(phase) * np.minimum(1, inside / 5) * np.minimum(1, (span - inside) / 5)
    filtered = sosfilt(
        butter(4, [0.05, 1.5], "bandpass", fs=1 / (time[1] - time[0]), output="sos"),
        rng.standard_normal(time.size + 2000),
    )[2000:]
    return filtered / filtered.std()


def flown(system, kind, rng, *, noise=0.1, pole=0.0, duration=164.0, rate=32.0):
    """Return a record of u, y that begins at rest.

    `noise` is AR(1) with `pole`, relative to the output.
    """
    time = np.arange(0, duration, 1 / rate)
    u = excitation(kind, time, rng)
    size = 1 << math.ceil(math.log2(time.size + 200 * rate))
    omega = HZ * np.fft.rfftfreq(size, 1 / rate)
    y = np.fft.irfft(
        np.fft.rfft(u, size) * system.response(1j * np.maximum(omega, 1e-9), system.truth), size
    )
    y = y[: time.size]
    errors = lfilter([math.sqrt(1 - pole**2)], [1, -pole], rng.standard_normal(time.size + 500))[
        500:
    ]
    return Record(time, {"u": u, "y": y + noise * y.std() * errors})


def maximum_likelihood(system: System, data: FrequencyResponse):
    """Return estimate and standard errors as `gb.MaximumLikelihood` has them for independent errors.

    A second implementation, and quick. Variances with ν degrees of freedom make the errors Student's
    t: the estimate is that of weights (ν + 2)/(ν + 2 r²), repeated until they no longer change, and
    standard errors are larger by about 1 + 2/ν than if the variances were exact.
    """
    deviation, dof = np.sqrt(data.variance / 2), data.dof

    def residuals(p):
        return (system.response(1j * data.omega, p) - data.response) / deviation

    def squares(p):
        return np.abs(residuals(p)) ** 2 / 2

    estimate = system.truth
    for _ in range(50):
        root = np.sqrt((dof + 2) / (dof + 2 * squares(estimate)))

        def weighted(p, root=root):
            e = root * residuals(p)
            return np.concatenate([e.real, e.imag])

        found = least_squares(
            weighted, estimate, x_scale=np.abs(system.truth), xtol=1e-12, ftol=1e-12, gtol=1e-12
        )
        change = np.max(np.abs(found.x - estimate) / np.abs(system.truth))
        estimate = found.x
        if change < 1e-9:
            break

    # A score has (ν + 2)/ν times the variance that its slope has, a weight of ν/(ν + 2 r²).
    n, p = len(data), estimate.size
    bread = np.linalg.inv(found.jac.T @ (np.tile(dof / (dof + 2), 2)[:, None] * found.jac))
    meat = found.jac.T @ found.jac

    r = squares(estimate)
    scale = 1.0
    for _ in range(200):
        scale *= np.mean((dof + 2) * r / (dof * scale + 2 * r))
    ratio = max(scale * 2 * n / (2 * n - p), 1.0)
    return estimate, np.sqrt(np.diag(bread @ meat @ bread) * ratio)
