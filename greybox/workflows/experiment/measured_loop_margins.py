"""Margins of a measured broken loop, with their errors."""

import math

import numpy as np

from greybox.assessment.response_band import require_level
from greybox.data.files.argument_checks import require_kind
from greybox.data.files.arrays import Array, ComplexArray
from greybox.data.files.numbers_in_text import number
from greybox.data.files.public import public
from greybox.data.files.wording import listed
from greybox.data.frequency_response import FrequencyResponse
from greybox.workflows.experiment.drawn_loops import DRAWS
from greybox.workflows.experiment.loop_numbers import margin_numbers
from greybox.workflows.experiment.margin_values import ORDER, UNITS, Margin, Margins

# Numbers that follow from the least distance from -1. Noise makes this distance too small, and
# draws from a noisy response make it smaller still, by about as much. The draws so show the bias,
# and their quantiles are reflected about the value.
LEAST = ("modulus margin", "disturbance rejection peak")


@public
def measured_margins(loop: FrequencyResponse, *, level: float = 0.95) -> Margins:
    """Return the margins of a measured broken loop, with the sign of negative feedback.

    Between the measured points, magnitude and phase are interpolated linearly over the logarithm of
    frequency. Nothing is extrapolated: a note names the margins that do not occur between the
    points. The intervals follow from draws from the errors of the points, which also correct the
    bias of the modulus margin. They are widened by the error of the interpolation, which is a third
    of the change when every second point is left out. The loop is taken as stable, because it flew.

    Parameters
    ----------
    loop : FrequencyResponse
        Without a variance, as `broken_loop` and `greybox.data.spectral` return it, there are no
        intervals.
    level : float
        Probability of the intervals.

    Returns
    -------
    Margins

    Source: Davison and Hinkley (1997), Bootstrap Methods and their Application, section 5.2 (basic
    intervals).
    """
    require_kind(
        "loop",
        loop,
        FrequencyResponse,
        "the FrequencyResponse of a broken loop; gb.margins takes a fit with its controller",
    )
    require_level(level)
    loop = loop.by_frequency
    points = np.log(loop.omega)
    gain, omega = measured_curves(loop)
    has_errors = len(gain) > 1
    numbers = margin_numbers(gain, omega)
    fewer = margin_numbers(*_between(points[::2], loop.response[None, ::2]))
    shares = [(1 - level) / 2, 0.5, (1 + level) / 2]
    rows = []
    unmeasured = []
    for name, (values, frequencies) in numbers.items():
        value = low = high = frequency = math.nan
        if values[0] and omega[0] < frequencies[0] < omega[-1]:
            value = values[0]
            frequency = frequencies[0]
            if has_errors:
                quantiles = np.quantile(values[1:], shares, method=ORDER)
                low, _, high = quantiles
                if name in LEAST:
                    high, value, low = 2 * value - quantiles
            # With points twice as far apart, linear interpolation has four times the error: the
            # change is three times the error.
            change = abs(fewer[name].value[0] - values[0]) if name in fewer else 0.0
            error = np.nan_to_num(change / 3, posinf=0)
            low = low - error
            high = high + error
        else:
            unmeasured.append(name)
        unit = UNITS[name.rstrip(" 0123456789")]
        rows.append(
            Margin(
                name,
                unit,
                float(value),
                float(low),
                float(high),
                float(frequency),
                group="measured",
            )
        )

    notes = []
    if not has_errors:
        notes.append("No intervals: the response has no variance.")
    if unmeasured:
        notes.append(
            f"Not measured, and nothing is extrapolated: {listed(unmeasured)}. The data cover "
            f"{omega[0]:.3g} to {omega[-1]:.3g} rad/s, with loop gains of {abs(gain[0, 0]):.2g} to "
            f"{abs(gain[0, -1]):.2g}: fly a wider band."
        )
    if "phase margin 2" in numbers:
        notes.append("The gain is one at several frequencies; the smallest margin counts.")
    widest = math.exp(np.diff(points).max(initial=0.0))
    # Sines at 0.6, 1.7 and 4.5 rad/s are closer than this ratio.
    if widest > 3.0:
        notes.append(
            f"Neighboring points differ by up to a factor of {number(widest, 2)} in frequency, and "
            "lines are assumed between them: measure more of them near the crossings."
        )
    plant = loop.name or "the measured response"
    # A measured response has no controller and no draws, so those fields are empty.
    level = level if has_errors else math.nan
    return Margins(
        plant,
        loop.input,
        "",
        "",
        tuple(rows),
        is_stable=True,
        instability=0.0,
        level=level,
        loop=None,
        notes=tuple(notes),
        points=(loop,),
    )


def measured_curves(loop: FrequencyResponse) -> tuple[ComplexArray, Array]:
    """Return the gain of a measured loop with draws from its errors (1 + draws, n), and omega (n,).

    All are interpolated between the measured points, which are in the order of frequency. Without a
    variance there are no draws.
    """
    return _between(np.log(loop.omega), _drawn(loop))


def _drawn(loop: FrequencyResponse) -> ComplexArray:
    """Return the response with draws from its errors (1 + draws, n); alone without a variance."""
    if loop.variance is None:
        return loop.response[None]
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
    """Return gains (m, k) that are interpolated between points, and their frequencies (k,), rad/s.

    `points` (n,) are logarithms of frequencies, and `response` (m, n) the gains there.
    """
    x = np.unique([*points, *np.linspace(points[0], points[-1], 300)])
    logarithm = np.log(np.abs(response)) + 1j * np.unwrap(np.angle(response), axis=1)
    return np.exp([np.interp(x, points, row) for row in logarithm]), np.exp(x)
