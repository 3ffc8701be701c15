"""Broken loops from measured responses, without a model of the plant.

Begin with `broken_loop`, from an injected signal; `measured_margins` reads the margins.
"""

import math
from dataclasses import replace

import numpy as np

from greybox.data.frequency_response import FrequencyResponse
from greybox.estimate.response_band import require_level
from greybox.experiment.drawn_loops import DRAWS
from greybox.experiment.loop_numbers import margin_numbers
from greybox.experiment.margins import UNITS, Margin, Margins
from greybox.files.arrays import Array, ComplexArray
from greybox.files.text_table import listed

# Noise makes the least distance from -1 too small, and draws from a noisy response make it smaller
# still. The draws so show the bias, and their quantiles are reflected about the value.
LEAST = ("modulus margin", "disturbance rejection peak")


def broken_loop(sensitivity: FrequencyResponse) -> FrequencyResponse:
    """Return the gain of the broken loop, L = 1/S - 1, of negative feedback.

    `sensitivity` is the measured response S from a signal that is injected into the loop to the sum
    of it and of what the loop returns there: from ``SIDD.Targ`` to the control ``RATE.POut``, or
    from a setpoint to the error. Errors are propagated to first order.

    Parameters
    ----------
    sensitivity : FrequencyResponse

    Returns
    -------
    FrequencyResponse

    Raises
    ------
    ValueError
        If the loop was open: S differs from 1 by no more than its errors, in the mean.
    """
    S, variance = sensitivity.response, sensitivity.variance
    if variance is not None and np.mean(np.abs(S - 1) ** 2 / variance) < 2:
        raise ValueError(
            f"the loop was open: {sensitivity.output} is no more than the injected "
            f"{sensitivity.input}; fly the test with the controller on."
        )
    # The derivative of 1/S is the factor of the errors.
    return replace(sensitivity.times(-1 / S**2), response=1 / S - 1)


def measured_margins(loop: FrequencyResponse, *, level: float = 0.95) -> Margins:
    """Return the margins of a measured broken loop, with negative feedback.

    They are read between the measured points, where magnitude and phase are straight lines over the
    logarithm of frequency, and never beyond them: a note names what does not occur there. The
    intervals come from draws from the errors of the points, which also correct the bias of the
    modulus margin, and are wider by the error of the interpolation, a third of what leaving out
    every second point changes. The loop is taken as stable, because it flew.

    Parameters
    ----------
    loop : FrequencyResponse
        With a variance, as `broken_loop` and `greybox.spectral` give it.
    level : float

    Returns
    -------
    Margins

    Source: Davison and Hinkley (1997), Bootstrap Methods and their Application, section 5.2 (basic
    intervals).

    Raises
    ------
    ValueError
        If the response has no variance.
    """
    require_level(level)
    order = np.argsort(loop.omega)
    points, drawn = np.log(loop.omega[order]), _drawn(loop)[:, order]
    gain, omega = _between(points, drawn)
    numbers = margin_numbers(gain, omega, np.ones(len(gain), dtype=bool))
    fewer = margin_numbers(*_between(points[::2], drawn[:1, ::2]), np.ones(1, dtype=bool))
    ends = [(1 - level) / 2, 0.5, (1 + level) / 2]
    rows, unmeasured = [], []
    for name, (values, places) in numbers.items():
        unit = UNITS[name.rstrip(" 0123456789")]
        row = Margin(name, unit, math.nan, math.nan, math.nan, math.nan, group="measured")
        if values[0] and omega[0] < places[0] < omega[-1]:
            value = float(values[0])
            drawn_ends = np.quantile(values[1:], ends, method="closest_observation")
            low, _, high = drawn_ends.tolist()
            if name in LEAST:
                high, value, low = (2 * value - drawn_ends).tolist()
            # Straight lines between twice as distant points are four times as wrong.
            change = abs(fewer[name].value[0] - values[0]) / 3 if name in fewer else 0.0
            error = float(change) if math.isfinite(change) else 0.0
            place = float(places[0])
            row = replace(row, value=value, omega=place, low=low - error, high=high + error)
        else:
            unmeasured.append(name)
        rows.append(row)

    notes = []
    if unmeasured:
        notes.append(
            f"Not measured, from {omega[0]:.3g} to {omega[-1]:.3g} rad/s with a gain from "
            f"{abs(gain[0, 0]):.2g} to {abs(gain[0, -1]):.2g}: {listed(unmeasured)}. Fly other "
            "frequencies; nothing is extrapolated."
        )
    if "phase margin 2" in numbers:
        notes.append("The gain is one at several frequencies; the smallest margin counts.")
    plant = loop.name or "the measured response"
    # There are no plants whose loops could be evaluated elsewhere.
    return Margins(plant, loop.input, "", "", tuple(rows), True, 0.0, level, None, tuple(notes))


def _drawn(loop: FrequencyResponse) -> ComplexArray:
    """Return the response and draws from its errors (1 + draws, n)."""
    if loop.variance is None:
        raise ValueError("the response has no variance: give one, as gb.spectral estimates it.")
    random = np.random.default_rng(0)
    errors = random.normal(size=(2, DRAWS, len(loop)))
    if loop.dof is not None:
        errors *= np.sqrt(loop.dof / random.chisquare(loop.dof, errors.shape[1:]))
    size = np.sqrt(loop.variance * loop.independent_share / 2)
    drawn = loop.response + size * (errors[0] + 1j * errors[1])
    if loop.common_errors is not None:
        drawn += random.normal(size=(DRAWS, len(loop.common_errors))) @ loop.common_errors
    return np.vstack([loop.response, drawn])


def _between(points: Array, response: ComplexArray) -> tuple[ComplexArray, Array]:
    """Return gains (m, k) interpolated between points (n,) of log omega, and omega (k,)."""
    x = np.unique([*points, *np.linspace(points[0], points[-1], 300)])
    logarithm = np.log(np.abs(response)) + 1j * np.unwrap(np.angle(response), axis=1)
    return np.exp([np.interp(x, points, row) for row in logarithm]), np.exp(x)
