"""The curves and points in diagrams of frequency responses: their names, colors and styles."""

import contextlib
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.estimate.fitted_part import FittedResponse
from greybox.estimate.response_band import ResponseBand
from greybox.estimate.result import Fit
from greybox.files.arrays import Array, Labels, StringPair, frozen
from greybox.files.text_table import in_greek
from greybox.plotting.figure import GRAY, INK, Series
from greybox.plotting.signals import distinct_labels


@frozen
class DrawnResponse:
    """A measured or a fitted response with its look.

    Attributes
    ----------
    response : FrequencyResponse
    label : str
    color, style : int
        As in `Series`.
    is_measured : bool
        Points, otherwise a curve.
    checksum : str
        Checksum of the data to which it belongs; empty for a curve without data.
    pair : (str, str)
    fit, band : Fit or None, ResponseBand or None
        The fit and the confidence band of a fitted curve.
    """

    response: FrequencyResponse
    label: str
    color: int
    style: int
    is_measured: bool
    checksum: str
    pair: StringPair
    fit: Fit | None = None
    band: ResponseBand | None = None

    def series(
        self,
        x: Array,
        y: Array,
        low: Array | None = None,
        high: Array | None = None,
        **more: Any,
    ) -> Series:
        """Return points or a curve with this look; `more` are other fields of `Series`."""
        kind = "points" if self.is_measured else "line"
        return Series(self.label, kind, x, y, self.color, self.style, low, high, **more)


@frozen
class _Part:
    """Data and curve of one part of a fit; a response alone is one of both."""

    label: str
    checksum: str = ""
    data: FrequencyResponse | None = None
    curve: FrequencyResponse | None = None
    fit: Fit | None = None
    number: int = 0

    @property
    def pair(self) -> StringPair:
        named = self.curve or self.data
        return (named.input, named.output) if named else ("", "")


def drawn_responses(
    items: Sequence[Fit | FrequencyResponse], labels: Labels, level: float | None
) -> list[DrawnResponse]:
    """Return the curves of all items, then their data; shared data only once.

    Curves of fits have bands of this `level`.

    Raises
    ------
    TypeError, ValueError
        For an item that is not a response, for no items, or for a wrong number of labels.
    """
    names = distinct_labels([_label(item) for item in items], labels)
    parts = list(map(_parts, items, names))
    every = [part for group in parts for part in group]
    if not every:
        raise ValueError(
            "there is no frequency response to draw: gb.plotting.time_history draws fitted records."
        )

    # By checksum: data that several fits share are drawn once.
    data = {part.checksum: part for part in every if part.data is not None}
    pairs = {part.checksum: part.pair for part in every if all(part.pair)}
    # Data without names belong to the curve of these data, or else to the only pair.
    only = next(iter(pairs.values())) if len(set(pairs.values())) == 1 else ("", "")

    curves = [_distinct(group) for group in parts]
    # One curve for several data sets must not have the color of one of them.
    is_shared = any(
        0 < len(distinct) < len([part for part in group if part.curve is not None])
        for group, distinct in zip(parts, curves, strict=True)
    )
    is_plain = is_shared or len(data) <= 1
    colors = {} if is_plain else {checksum: k for k, checksum in enumerate(data)}
    drawn = []
    for i, name in enumerate(names):
        plain_color = i if len(data) <= 1 else (INK if i == 0 else GRAY)
        for part, curve in curves[i]:
            color = colors.get(part.checksum, plain_color)
            look = {"fit": part.fit, "band": _band(part, level)}
            pair = part.pair if all(part.pair) else only
            drawn.append(DrawnResponse(curve, name, color, i, False, part.checksum, pair, **look))

    for k, (checksum, part) in enumerate(data.items()):
        assert part.data is not None
        pair = pairs.get(checksum, only)
        color = k if len(data) > 1 else INK
        drawn.append(DrawnResponse(part.data, part.label, color, k, True, checksum, pair))

    return drawn


def title(items: Sequence[Fit | FrequencyResponse]) -> str:
    """Return the names of the fits, or else of the data, in at most 64 characters.

    Fits that did not converge are marked.
    """
    fits = [item for item in items if isinstance(item, Fit)]
    names = [fit.name if fit.converged else f"{fit.name}: no start converged" for fit in fits]
    text = _joined(names or [item.name for item in items if item.name])
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


def _parts(item: Fit | FrequencyResponse, name: str) -> list[_Part]:
    if isinstance(item, Fit):
        return [
            _Part(part.name, part.data.checksum, part.data, part.curve, item, k)
            for k, part in enumerate(item.parts)
            if isinstance(part, FittedResponse)
        ]
    return [_Part(name, curve=item) if item.source == "model" else _Part(name, item.checksum, item)]


def _band(part: _Part, level: float | None) -> ResponseBand | None:
    """Return the band of a curve, if its covariance is known."""
    if level is None or part.fit is None or part.fit.directions is None:
        return None
    with contextlib.suppress(LookupError):  # a loaded fit of a model that greybox does not include
        band = part.fit.response_band(level=level, part=part.number)
        return band if np.any(np.isfinite(band.relative_error)) else None
    return None


def _distinct(parts: Sequence[_Part]) -> list[tuple[_Part, FrequencyResponse]]:
    """Return the curves, except those that lie on a longer one."""
    # Four rotors with one model would draw one line four times, in four colors.
    curves = [(part, part.curve.by_frequency) for part in parts if part.curve is not None]

    distinct: list[tuple[_Part, FrequencyResponse]] = []
    for part, curve in sorted(curves, key=lambda pair: pair[1].omega[0] / pair[1].omega[-1]):
        if not any(_lies_on(curve, longer) for _, longer in distinct):
            distinct.append((part, curve))
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
        return f"fit of {_joined(part.label for part in item.parts)}"
    if isinstance(item, FrequencyResponse):
        return item.name or "data"
    raise TypeError(f"cannot draw {item!r:.80}: give a Fit or a FrequencyResponse.")


def _joined(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(names))
