"""Frequency responses of sweeps and noise, by local polynomials over the excited band."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.checked_array import finite_numbers
from greybox.data.files.argument_checks import require_whole
from greybox.data.files.arrays import Array, ComplexArray, Interval
from greybox.data.files.public import public
from greybox.data.frequency_band import require_band
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.intersample import HOLD, SPACING, hold_of_response, response_of_hold
from greybox.data.record import Record
from greybox.data.spectral.estimated_points import HZ, response_at, without_incoherent
from greybox.data.spectral.local_polynomials import Lines, lines_of, points_at, tiled_points
from greybox.data.spectral.uniform_stretches import uniform_stretches

# Fewest periods in the longest stretch: below, a band of polynomials would reach zero.
LOWEST = 6


# The estimator for a short record of one doublet, 2-1-1 or step.
FOR_MANOEUVRES = "gb.spectral.transient_spectrum, which needs only one period"


@public
def spectral_response(  # noqa: PLR0913 - every choice that an analyst makes
    records: Record | Sequence[Record],
    input: str = "u",
    output: str = "theta",
    *,
    instrument: str | None = None,
    conditioned: Sequence[str] | Mapping[str, str] = (),
    omega: ArrayLike | None = None,
    band: Interval | None = None,
    points: int = 40,
    name: str = "",
    near: Callable[[Array], ComplexArray] | None = None,
) -> FrequencyResponse:
    """Estimate a frequency response from sweeps or noise.

    Response and transients are polynomials in bands of the transform of the whole record (see
    `greybox.data.spectral.local_polynomials`). Bands become narrower until the polynomials are
    accurate. Each gives three points whose errors are independent, so that a likelihood may use
    them.

    Stretches between gaps or missing samples are transformed separately and used together, as are
    several records. Offsets and straight lines in the output count as transients.

    Parameters
    ----------
    records : Record or sequence of Record
        Uniformly sampled.
    input, output : str
    instrument : str, optional
        The injected signal, for the joint input-output estimate; without it, the direct one.
    conditioned : sequence of str, or mapping from str to str
        Further inputs that act on the output and are correlated with this one; their effect is
        removed (partial coherence, Bendat and Piersol, section 7.3). Where feedback moves them,
        disturbances bias the response: give the injected signal of each as well, as in {"rudder":
        "rudder_sweep"}, and records in which either input is excited, for the joint estimate of all
        inputs.
    omega : (n,) array, rad/s, optional
        By default, frequencies where the excitation is strong. If they are closer than the
        resolution, about 8 / duration in Hz for a band of three points, the errors of neighbors are
        correlated.
    band : (low, high), rad/s, optional
        Band of the estimate, within the resolution of the record; by default, where excitation is
        strong.
    points : int
        Approximate number of frequencies: fewer where the record does not resolve them, more at
        resonances.
    name : str
        Name of the response.
    near : function of (n,) array, rad/s, optional
        A response near the true one, such as that of a fitted model, without the hold of the input.
        The polynomials then describe what it leaves, so that their error and that of the noise are
        smaller where the response changes much from line to line: at the lowest frequencies, and at
        resonances. A tenth of the error that is subtracted in this way counts as uncertain,
        because the fitted response may be wrong by so much. Not used if `omega` is given.

    Returns
    -------
    FrequencyResponse
        With coherence, variance E|P̂ - P|² and its degrees of freedom. Points are left out where
        too little remains to estimate the noise, or where the instrument hardly moves the input;
        without `omega` also those of a coherence below 0.6, and ends that are too uncertain.
        The coherence is partial, without transients and conditioned inputs; with an instrument, it
        is the lower of its coherences with input and output. The variance assumes stationary noise.

    Raises
    ------
    ValueError
        If the records are too short or not uniform, or a frequency has fewer than six periods in
        the longest stretch.
    KeyError
        For a signal that a record does not hold.
    """
    require_whole("points", points, 2)
    instruments = conditioned.values() if isinstance(conditioned, Mapping) else conditioned
    signals = [input, output, instrument or input, *conditioned, *instruments]
    if signals.count(output) > 1:
        raise ValueError(
            f"{output} is the output: name another signal as input, instrument or conditioned."
        )
    stretches = uniform_stretches(records, signals)
    lines = lines_of(stretches)
    lowest = LOWEST * lines.spacing
    if omega is None:
        limits = (lowest, 0.4 * HZ / max(s.step for s in stretches))  # of the sampling rate
        ends = _excited_band(lines, *limits) if band is None else _within(band, *limits)
        # The samples are those of the held input: without the hold, half a sample of phase would
        # remain of each resonance.
        holds = [(s.record.hold, s.step) for s in stretches]
        seconds = float(hold_of_response(input, output, holds).get(HOLD, 0.0))
        sampled = near and (lambda w: near(w) * response_of_hold(w, seconds))
        estimated = tiled_points(lines, *ends, points, sampled)
    else:
        grid = finite_numbers("omega", omega)
        if not grid.size:
            raise ValueError("omega has no frequencies: give at least one, or leave it out.")
        too_low = grid[grid < lowest * (1 - 1e-9)]
        if too_low.size:
            raise ValueError(
                f"omega = {too_low[0]:g} rad/s has fewer than {LOWEST} periods in the longest "
                f"stretch, {HZ / lines.spacing:.4g} s: leave out frequencies below {lowest:.4g} "
                f"rad/s, record longer, or use {FOR_MANOEUVRES}."
            )
        estimated = points_at(lines, grid)

    response = response_at(estimated, stretches, input, output, name)
    response = replace(response, about={**response.about, SPACING: f"{lines.spacing:.6g}"})
    return response if omega is not None else without_incoherent(response)


def _within(band: Interval, lowest: float, highest: float) -> Interval:
    """Return the part of a band that the records resolve."""
    low, high = require_band(band)
    if not max(low, lowest) < min(high, highest):
        raise ValueError(
            f"these records resolve {lowest:.4g} to {highest:.4g} rad/s, not the band from "
            f"{low:.4g} to {high:.4g} rad/s: choose another band, record longer or faster, or use "
            f"{FOR_MANOEUVRES}."
        )
    return max(low, lowest), min(high, highest)


def _excited_band(lines: Lines, lowest: float, highest: float) -> Interval:
    """Return the band around the strongest excitation, up to the first gap in it on either side."""
    if lowest >= highest:
        raise ValueError(
            f"the records are too short: their lowest frequency, {lowest:.4g} rad/s, is above the "
            f"highest that the sampling allows, {highest:.4g} rad/s; record longer, or use "
            f"{FOR_MANOEUVRES}."
        )
    fine = np.geomspace(lowest, highest, 200)
    # Averaged over a band as wide as 0.3 of its frequency, because the spectrum of noise has holes
    # by chance.
    reach = np.maximum(fine * 0.3 / 2, 2 * lines.spacing)
    first = np.searchsorted(lines.omega, fine - reach)
    last = np.searchsorted(lines.omega, fine + reach)
    # Cumulative power makes the mean over any band a difference of two numbers.
    total = np.concatenate([[0.0], np.cumsum(np.abs(lines.values[2]) ** 2)])
    power = fine * (total[last] - total[first]) / (last - first)

    # The excitation ends 20 dB below the largest ω S(ω), which a logarithmic sweep keeps constant.
    # For white noise of 60 s through a resonance of 1 Hz, the grid begins at 0.64 Hz with 0.03, at
    # 0.17 Hz with 0.01, and with 0.003 it extends to 15 Hz, where the output is noise.
    weak = np.flatnonzero(power < 0.01 * power.max())
    strongest = int(power.argmax())
    first_strong = int(max(weak[weak < strongest], default=-1)) + 1
    last_strong = int(min(weak[weak > strongest], default=fine.size)) - 1
    return float(fine[first_strong]), float(fine[last_strong])
