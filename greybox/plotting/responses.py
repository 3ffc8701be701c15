"""The curves and points in diagrams of frequency responses: their names, colors and styles."""

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.estimate.response_band import ResponseBand
from greybox.estimate.result import Fit
from greybox.files.arrays import Array
from greybox.files.text_table import in_greek
from greybox.plotting.figure import GRAY, INK, Series
from greybox.plotting.signals import distinct_labels

Pair = tuple[str, str]
"""Names of input and output."""


@dataclass(frozen=True, eq=False)
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
    pair: Pair
    fit: Fit | None = None
    band: ResponseBand | None = None

    def series(
        self,
        x: Array,
        y: Array,
        low: Array | None = None,
        high: Array | None = None,
        notes: Sequence[str] = (),
        labels: Sequence[str] = (),
    ) -> Series:
        """Return points or a curve with this look."""
        kind = "points" if self.is_measured else "line"
        return Series(
            self.label, kind, x, y, self.color, self.style, low, high, notes, labels, width=1.8
        )


def drawn_responses(
    items: Sequence[Fit | FrequencyResponse], labels: Sequence[str], level: float | None = None
) -> list[DrawnResponse]:
    """Return the curves of all items, then their data; shared data only once.

    Curves of fits have bands of this `level`.

    Raises
    ------
    TypeError, ValueError
        For an item that is not a response, for no items, or for a wrong number of labels.
    """
    names = distinct_labels([_label(item) for item in items], labels)
    if all(isinstance(item, Fit) and not item.responses for item in items):
        raise ValueError(
            "there is no frequency response to draw: gb.plotting.time_history draws fitted records."
        )

    # By checksum: data that several fits share are drawn once.
    data: dict[str, tuple[FrequencyResponse, str]] = {}
    for item, name in zip(items, names, strict=True):
        if isinstance(item, Fit):
            data |= {part.data.checksum: (part.data, part.name) for part in item.responses}
        elif item.source != "model":
            data[item.checksum] = (item, name)

    pairs = _pairs(items)

    measured = [
        DrawnResponse(
            response,
            label,
            color=k if len(data) > 1 else INK,
            style=k,
            is_measured=True,
            checksum=checksum,
            pair=_pair(response, pairs),
        )
        for k, (checksum, (response, label)) in enumerate(data.items())
    ]
    return [*_curves(items, names, [*data], pairs, level), *measured]


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


def _curves(
    items: Sequence[Fit | FrequencyResponse],
    names: Sequence[str],
    checksums: Sequence[str],
    pairs: Mapping[str, Pair],
    level: float | None,
) -> list[DrawnResponse]:
    """Return the curves, in the color of their data where the data differ in color."""
    curves = [_distinct(_curves_of(item)) for item in items]
    # One curve for several data sets must not have the color of one of them.
    is_shared = any(
        isinstance(item, Fit) and 0 < len(distinct) < len(item.responses)
        for item, distinct in zip(items, curves, strict=True)
    )
    drawn = []
    for i, item in enumerate(items):
        for checksum, curve in curves[i]:
            color = i
            if len(checksums) > 1:
                has_color = checksum in checksums and not is_shared
                color = checksums.index(checksum) if has_color else (INK if i == 0 else GRAY)
            fit = item if isinstance(item, Fit) else None
            drawn.append(
                DrawnResponse(
                    curve,
                    names[i],
                    color,
                    style=i,
                    is_measured=False,
                    checksum=checksum,
                    pair=_pair(curve, pairs),
                    fit=fit,
                    band=_band(fit, checksum, level) if fit and level is not None else None,
                )
            )

    return drawn


def _band(fit: Fit, checksum: str, level: float) -> ResponseBand | None:
    """Return the band of the curve that was fitted to these data, if its covariance is known."""
    if fit.directions is None:
        return None
    part = next(k for k, part in enumerate(fit.parts) if part.data.checksum == checksum)
    with contextlib.suppress(LookupError):  # a loaded fit of a model that greybox does not include
        band = fit.response_band(level=level, part=part)
        return band if np.any(np.isfinite(band.relative_error)) else None
    return None


def _pairs(items: Sequence[Fit | FrequencyResponse]) -> dict[str, Pair]:
    """Return the names of input and output by checksum of the data."""
    pairs = {}
    for item in items:
        if isinstance(item, FrequencyResponse):
            pairs.setdefault(item.checksum, (item.input, item.output))
            continue
        for part in item.responses:
            named = part.curve or part.data
            pairs[part.data.checksum] = (named.input, named.output)

    return {checksum: pair for checksum, pair in pairs.items() if all(pair)}


def _pair(response: FrequencyResponse, pairs: Mapping[str, Pair]) -> Pair:
    """Return the names of input and output; missing ones come from the curve of these data."""
    # Data without names and without a curve belong to the only pair, if there is just one.
    pair = response.input, response.output
    if all(pair):
        return pair
    only = next(iter(pairs.values())) if len(set(pairs.values())) == 1 else pair
    return pairs.get(response.checksum, only)


def _curves_of(item: Fit | FrequencyResponse) -> list[tuple[str, FrequencyResponse]]:
    """Return the curves of an item, each with the checksum of its data."""
    if isinstance(item, Fit):
        parts = [(part.data.checksum, part.curve) for part in item.responses]
        return [(checksum, _sorted(curve)) for checksum, curve in parts if curve is not None]
    return [("", _sorted(item))] if item.source == "model" else []


def _sorted(curve: FrequencyResponse) -> FrequencyResponse:
    order = np.argsort(curve.omega)
    return replace(curve, omega=curve.omega[order], response=curve.response[order])


def _distinct(curves: list[tuple[str, FrequencyResponse]]) -> list[tuple[str, FrequencyResponse]]:
    """Leave out curves that lie on a longer one, as those of several rotors with one model do."""
    # Four rotors with one model would draw one line four times, in four colors.
    longest_first = sorted(curves, key=lambda pair: pair[1].omega.min() / pair[1].omega.max())
    distinct: list[tuple[str, FrequencyResponse]] = []
    for checksum, curve in longest_first:
        if not any(_lies_on(curve, longer) for _, longer in distinct):
            distinct.append((checksum, curve))
    return distinct


def _lies_on(curve: FrequencyResponse, longer: FrequencyResponse) -> bool:
    if (curve.input, curve.output) != (longer.input, longer.output):
        return False
    # Ends of grids over the same band differ by rounding.
    low, high = 0.999 * longer.omega.min(), 1.001 * longer.omega.max()
    reference = interpolated(curve.omega, longer.omega, longer.response)
    # Curves that differ by less than 1 % look like one line.
    is_near = np.abs(curve.response - reference) <= 0.01 * np.abs(reference)
    return bool(np.all((low <= curve.omega) & (curve.omega <= high) & is_near))


def _label(item: Fit | FrequencyResponse) -> str:
    if isinstance(item, Fit):
        return f"fit of {_joined(part.label for part in item.parts)}"
    if isinstance(item, FrequencyResponse):
        return item.name or "data"
    raise TypeError(f"cannot draw {item!r:.80}: give a Fit or a FrequencyResponse.")


def _joined(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(names))
