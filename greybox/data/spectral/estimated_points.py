"""Collects the estimates at all frequencies into a `FrequencyResponse`."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from greybox.data.files.arrays import Array, BoolArray, ComplexArray
from greybox.data.files.grouping import unique
from greybox.data.files.wording import counted
from greybox.data.frequency_response import DAMAGE, FrequencyResponse
from greybox.data.intersample import hold_of_response
from greybox.data.signal_faults import record_faults
from greybox.data.spectral.uniform_stretches import UniformStretch

HZ = math.tau  # rad/s
EPS = np.finfo(float).eps

# Least ratio of the power of the input that the instrument explains to that of its noise. Below,
# the ratio is biased toward the direct estimate and its standard error is too small (Staiger and
# Stock (1997), Econometrica 65: the F statistic of the first stage).
STRONG = 10

COHERENT = 0.6  # least coherence of an automatic point: Tischler and Remple, section 5.5


class EstimatedPoints(NamedTuple):
    """The estimates at frequencies (n,); the variances are NaN where the instrument is `weak`."""

    omega: Array
    response: ComplexArray
    variance: Array
    dof: Array
    coherence: Array
    weak: BoolArray


def response_at(
    points: EstimatedPoints, stretches: Sequence[UniformStretch], input: str, output: str, name: str
) -> FrequencyResponse:
    """Return the response at the points that could be estimated; `name` is its name.

    Points where the instrument is too weak are left out, and `about` says so.

    Raises
    ------
    ValueError
        If no point could be estimated.
    """
    omega, response, variance, dof, coherence, weak = points
    # A response without a variance has no weight in a likelihood.
    good = np.isfinite(variance)
    if not good.any():
        if weak.any():
            raise ValueError(
                f"the instrument hardly moves {input}: at no frequency is its effect {STRONG} "
                "times as strong as the noise; excite more strongly or longer, or use another "
                "instrument."
            )
        raise ValueError(
            "no frequency has enough data: the excitation must cover a band, and be longer than "
            "six periods of its lowest frequency."
        )

    facts = measured_in(stretches, input, output)
    if weak.any():
        dropped = _dropped(omega, weak, f"where the instrument hardly moves {input}")
        facts["about"]["dropped"] = dropped
    # A lower bound of the variance, for data without noise.
    rounding = (4 * EPS * np.abs(response)) ** 2
    return FrequencyResponse(
        omega[good],
        response[good],
        input,
        output,
        np.clip(coherence, EPS, 1)[good],
        np.maximum(variance, rounding)[good],
        dof[good],
        name,
        **facts,
    )


def measured_in(stretches: Sequence[UniformStretch], input: str, output: str) -> dict[str, Any]:
    """Return source, stretches, units, hold and damage of a response from these stretches."""
    about = hold_of_response(input, output, [(s.record.hold, s.step) for s in stretches])
    records = {id(s.record): s.record for s in stretches}.values()
    faults = [str(fault) for r in records for fault in record_faults(r, (output,), (input,))]
    if faults:
        about = {**about, DAMAGE: " ".join(unique(faults))}
    return {
        "source": ", ".join(unique(s.record.source for s in stretches if s.record.source)),
        "stretches": tuple(s.origin for s in stretches),
        "units": {n: u for n, u in stretches[0].record.units.items() if n in (input, output) and u},
        "about": about,
    }


def without_incoherent(response: FrequencyResponse) -> FrequencyResponse:
    """Leave out points of low coherence and uncertain ends, which `about` then states."""
    from scipy.ndimage import minimum_filter1d  # noqa: PLC0415  (takes a tenth of a second)

    coherent: BoolArray = response.coherence >= COHERENT  # type: ignore[operator]
    # Beyond the excitation, polynomials extrapolate, and the coherence is that of their whole band.
    # An end is judged by the magnitude of its neighbor too: noise makes its own large.
    size = minimum_filter1d(np.abs(response.response), 3)
    sure = response.omega[np.sqrt(np.asarray(response.variance)) < size / 2]
    coherent &= response.omega >= sure.min(initial=np.inf)
    coherent &= response.omega <= sure.max(initial=0.0)
    # If all points are low, none is left out: the user should see them.
    if not coherent.any() or coherent.all():
        return response
    text = _dropped(
        response.omega, ~coherent, f"with a coherence below {COHERENT}, or too uncertain at an end"
    )
    earlier = [response.about["dropped"]] if "dropped" in response.about else []
    return replace(
        response.where(coherent), about={**response.about, "dropped": "; ".join([*earlier, text])}
    )


def _dropped(omega: Array, dropped: BoolArray, why: str) -> str:
    low, high = omega[dropped].min(), omega[dropped].max()
    place = f"{low:.4g} to {high:.4g} rad/s" if high > low else f"{low:.4g} rad/s"
    return f"{dropped.sum()} of {counted(omega.size, 'point')}, {why}, at {place}"
