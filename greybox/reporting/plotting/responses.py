"""The curves and points in diagrams of frequency responses: their names, colors and styles."""

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.assessment.fitted_part import FittedResponse
from greybox.assessment.response_band import ResponseBand
from greybox.assessment.result import Fit
from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.greek_letters import in_greek
from greybox.data.files.grouping import unique
from greybox.data.frequency_response import FrequencyResponse
from greybox.reporting.plotting.figure import GRAY, INK, Series, require_drawable
from greybox.reporting.plotting.signals import distinct_labels


@frozen
class DrawnResponse:
    """A measured or a fitted response with its look.

    Attributes
    ----------
    response : FrequencyResponse
    label : str
    is_measured : bool
        Points, otherwise a curve.
    checksum : str
        Checksum of the data to which it belongs; empty for a curve without data.
    pair : (str, str)
    fit, part, band : Fit or None, int, ResponseBand or None
        The fit, the number of the part, and the confidence band of a fitted curve.
    color, style : int
        As in `Series`.
    """

    response: FrequencyResponse
    label: str
    is_measured: bool
    checksum: str
    pair: tuple[str, str]
    fit: Fit | None = None
    part: int = 0
    band: ResponseBand | None = None
    color: int = 0
    style: int = 0

    def series(
        self,
        x: Array,
        y: Array,
        **more: Any,
    ) -> Series:
        """Return points or a curve with this look; `more` are other fields of `Series`."""
        kind = "points" if self.is_measured else "line"
        return Series(self.label, kind, x, y, self.color, self.style, **more)


def drawn_responses(
    items: Sequence[Fit | FrequencyResponse], labels: Sequence[str], level: float | None
) -> list[DrawnResponse]:
    """Return the curves of all items, then their data; shared data only once.

    Curves of fits have bands of this `level`.

    Raises
    ------
    TypeError, ValueError
        For an item that is not a response, for no items, or for a wrong number of labels.
    """
    names = distinct_labels([_label(item) for item in items], labels)
    groups = list(map(_responses, items, names))
    every = [drawn for group in groups for drawn in group]
    if not every:
        raise ValueError(
            "there is no frequency response to draw: gb.plotting.time_history draws fitted records."
        )

    # By checksum: data that several fits share are drawn once.
    data = {drawn.checksum: drawn for drawn in every if drawn.is_measured}
    pairs = {drawn.checksum: drawn.pair for drawn in every if all(drawn.pair)}
    # Data without names belong to the curve of these data, or else to the only pair.
    only = next(iter(pairs.values())) if len(set(pairs.values())) == 1 else ("", "")

    curves = [[drawn for drawn in group if not drawn.is_measured] for group in groups]
    distinct = list(map(_distinct, curves))
    # One curve for several data sets must not have the color of one of them.
    is_shared = sum(map(len, distinct)) < sum(map(len, curves))
    is_plain = is_shared or len(data) <= 1
    colors = {} if is_plain else {checksum: k for k, checksum in enumerate(data)}
    drawn = []
    for i, group in enumerate(distinct):
        plain_color = i if len(data) <= 1 else (INK if i == 0 else GRAY)
        for curve in group:
            color = colors.get(curve.checksum, plain_color)
            pair = curve.pair if all(curve.pair) else only
            band = _band(curve, level)
            drawn.append(replace(curve, pair=pair, band=band, color=color, style=i))

    for k, (checksum, points) in enumerate(data.items()):
        color = k if len(data) > 1 else INK
        drawn.append(replace(points, pair=pairs.get(checksum, only), color=color, style=k))

    return drawn


def by_pair(responses: Sequence[DrawnResponse]) -> list[list[DrawnResponse]]:
    """Return the responses of each input-output pair."""
    # In the order of the data, which is the one that a user knows.
    measured_first = sorted(responses, key=lambda drawn: not drawn.is_measured)
    pairs = unique(drawn.pair for drawn in measured_first)
    return [[drawn for drawn in responses if drawn.pair == pair] for pair in pairs]


def title(items: Sequence[Fit | FrequencyResponse]) -> str:
    """Return the names of the fits, or else of the data, in at most 64 characters.

    Fits that did not converge are marked.
    """
    fits = [item for item in items if isinstance(item, Fit)]
    names = [fit.name if fit.converged else f"{fit.name}: no start converged" for fit in fits]
    text = ", ".join(unique(names or [item.name for item in items if item.name]))
    return text if len(text) <= 64 else text[:63].rstrip() + "…"


def ratio(responses: Sequence[DrawnResponse]) -> str:
    """Return output/input in symbols, e.g. θ/u, or P(jω) where they differ."""
    inputs = {drawn.pair[0] for drawn in responses} - {""}
    outputs = {drawn.pair[1] for drawn in responses} - {""}
    if len(outputs) != 1 or len(inputs) != 1:
        return "P(jω)"
    return f"{in_greek(*outputs)}/{in_greek(*inputs)}"


def interpolated(omega: NDArray, grid: NDArray, values: NDArray) -> NDArray:
    """Interpolate `values` (n,) from the sorted `grid` (n,) over log frequency to `omega` (m,)."""
    return np.interp(np.log(omega), np.log(grid), values)


def _responses(item: Fit | FrequencyResponse, name: str) -> list[DrawnResponse]:
    """Return the data and curves of an item in turn, with the pairs that they name."""
    if isinstance(item, FrequencyResponse):
        pair = item.input, item.output
        if item.source == "model":
            return [DrawnResponse(item.by_frequency, name, False, "", pair)]
        return [DrawnResponse(item, name, True, item.checksum, pair)]
    drawn = []
    for k, part in enumerate(item.parts):
        if isinstance(part, FittedResponse):
            named = part.curve or part.data
            place = part.data.checksum, (named.input, named.output)
            drawn.append(DrawnResponse(part.data, part.name, True, *place))
            if part.curve is not None:
                curve = part.curve.by_frequency
                drawn.append(DrawnResponse(curve, name, False, *place, item, k))
    return drawn


def _band(curve: DrawnResponse, level: float | None) -> ResponseBand | None:
    """Return the band of a curve, if its covariance is known."""
    if level is None or curve.fit is None or curve.fit.directions is None:
        return None
    with contextlib.suppress(LookupError):  # a loaded fit of a model that greybox does not include
        band = curve.fit.response_band(level=level, part=curve.part)
        return band if np.any(np.isfinite(band.relative_error)) else None
    return None


def _distinct(curves: Sequence[DrawnResponse]) -> list[DrawnResponse]:
    """Return the curves, except those that lie on a longer one."""
    # Four rotors with one model would draw one line four times, in four colors.
    distinct: list[DrawnResponse] = []
    for curve in sorted(curves, key=lambda c: c.response.omega[0] / c.response.omega[-1]):
        if not any(_lies_on(curve.response, longer.response) for longer in distinct):
            distinct.append(curve)
    return distinct


def _lies_on(curve: FrequencyResponse, longer: FrequencyResponse) -> bool:
    if (curve.input, curve.output) != (longer.input, longer.output):
        return False
    # Ends of grids over the same band differ by rounding.
    low, high = 0.999 * longer.omega.min(), 1.001 * longer.omega.max()
    reference = interpolated(curve.omega, longer.omega, longer.response)
    # Curves that differ by less than 1 % look like one line.
    is_near = np.allclose(curve.response, reference, rtol=0.01, atol=0)
    return is_near and bool(low <= curve.omega.min() and curve.omega.max() <= high)


def _label(item: Fit | FrequencyResponse) -> str:
    if isinstance(item, Fit):
        return f"fit of {', '.join(item.labels)}"
    require_drawable(item, FrequencyResponse, "a Fit or a FrequencyResponse")
    return item.name or "data"
