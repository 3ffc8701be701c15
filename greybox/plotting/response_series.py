"""What a diagram of frequency responses shows: measured points, fitted curves with their bands, and errors of a fit."""

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.estimate.response_band import ResponseBand
from greybox.estimate.result import Fit
from greybox.files.arrays import ComplexArray
from greybox.plotting.style import COLORS, DARK, GRAYS, MARKERS, plain, symbol

LINE_STYLES = ("-", "--", "-.", ":")
MARKER_SIZE = 5.5  # points
CROWD = 100  # points of one data set from which on they shrink and lie below the curves
BAND_ALPHA = 0.2  # opacity of a band
SAME_CURVE = 1e-2  # relative distance below which two curves of one fit look like one line


@dataclass(frozen=True, eq=False)
class ResponseSeries:
    """Measured points (of the style of a marker) or a curve (of the style of a line), and what it belongs to.

    `checksum` is that of the data, `pair` the names of input and output, `fit` and `band` are those
    of a fitted curve, the band where it is known.
    """

    response: FrequencyResponse
    label: str
    color: str
    style: str
    checksum: str
    pair: tuple[str, str]
    band: ResponseBand | None = None
    fit: Fit | None = None

    @property
    def measured(self) -> bool:
        """True for points, False for a curve."""
        return self.style in MARKERS

    @property
    def look(self) -> dict[str, Any]:
        """The keywords of matplotlib's `plot`."""
        look = {"color": self.color, "label": self.label}
        if not self.measured:
            marker = "" if len(self.response) > 1 else "+"
            return {**look, "linestyle": self.style, "marker": marker, "linewidth": 1.8}

        shrink = min(
            1.0, (CROWD / len(self.response)) ** 0.5
        )  # the ink of all points together stays the same
        return {
            **look,
            "linestyle": "none",
            "marker": self.style,
            "markeredgecolor": "white",
            "markeredgewidth": 0.5 if shrink == 1 else 0.0,
            "markersize": max(2.0, shrink * MARKER_SIZE),
            "zorder": 3 if shrink == 1 else 1.5,
        }

    @property
    def key(self) -> Line2D:
        """The key in a legend."""
        size = {"markersize": MARKER_SIZE} if self.measured else {}
        return Line2D([], [], **{**self.look, **size})


@dataclass(frozen=True, eq=False)
class ErrorSeries:
    """How far measured points lie from the curve that was fitted to them.

    Attributes
    ----------
    data : FrequencyResponse
        What was measured, (n,).
    ratio : (n,) complex array
        Of measured to fitted response.
    look : dict
        The keywords of matplotlib's `plot`.
    """

    data: FrequencyResponse
    ratio: ComplexArray
    look: dict[str, Any]


def error_series(
    items: Sequence[Fit | FrequencyResponse], series: Sequence[ResponseSeries]
) -> list[ErrorSeries]:
    """Return the errors of every fit, in the look of its data; of several fits in the color of their curves."""
    fits = [item for item in items if isinstance(item, Fit)]
    points = {one.checksum: one for one in series if one.measured}
    curves = [one for one in series if not one.measured and one.checksum]
    found = []
    for k, fit in enumerate(fits):
        for part in fit.responses:
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = part.data.response / part.response
            if not np.any(np.isfinite(ratio)):
                continue
            shown = points[part.data.checksum]
            look = {**shown.look, "label": f"_{shown.label}"}
            if len(fits) > 1:
                own = [one for one in curves if one.fit is fit]
                own = [one for one in own if one.checksum == part.data.checksum] or own
                look["color"] = own[0].color if own else shown.color
                if k:  # data that several fits share: told apart also where the curves have the color of the data
                    look |= {
                        "markerfacecolor": "none",
                        "markeredgecolor": look["color"],
                        "markeredgewidth": 1.0,
                    }
            found.append(ErrorSeries(part.data, ratio, look))
    return found


def legend_entries(series: Sequence[ResponseSeries]) -> dict[str, tuple[Artist, ...]]:
    """Return the legend of all data, then of the curves and bands: one entry a fit, with all its colors."""
    entries: dict[str, dict[str, Line2D]] = {}
    for one in sorted(series, key=lambda one: not one.measured):
        entries.setdefault(one.label, {})[one.color + one.style] = one.key
    legend: dict[str, tuple[Artist, ...]] = {
        label: tuple(keys.values()) for label, keys in entries.items()
    }
    shaded = {one.color: one.band.level for one in series if one.band is not None}
    if shaded:
        level = 100 * next(iter(shaded.values()))
        legend[f"{level:g} % band"] = tuple(
            Patch(color=c, alpha=BAND_ALPHA, linewidth=0) for c in shaded
        )
    return legend


def ratio(series: Sequence[ResponseSeries]) -> str:
    """Return output/input in symbols, e.g. θ/u, or P(jω) where they are not the same for all."""
    inputs = {one.pair[0] for one in series} - {""}
    outputs = {one.pair[1] for one in series} - {""}
    return f"{symbol(*outputs)}/{symbol(*inputs)}" if len(outputs) == len(inputs) == 1 else "P(jω)"


def response_series(
    items: Sequence[Fit | FrequencyResponse], labels: Sequence[str], level: float | None = None
) -> list[ResponseSeries]:
    """Return the curves of all items, and then their data; data that several share are there once.

    Curves of fits have their bands at this `level`.

    Raises
    ------
    TypeError, ValueError
        For what is no frequency response, for nothing, or for labels that are not as many as the
        items.
    """
    _check(items, labels)
    names = [plain(label) for label in labels or _labels(items)]
    measured = {
        r.checksum: (r, label)
        for k, name in zip(items, names, strict=True)
        for r, label in _data(k, name)
    }
    curves = [_distinct(_curves(item)) for item in items]
    pairs = _pairs(items)
    return [
        *_curve_series(items, curves, names, [*measured], pairs, level),
        *_data_series(measured, pairs),
    ]


def title(items: Sequence[Fit | FrequencyResponse]) -> str:
    """Return the names of the fits, else of the data, and which fits did not converge; 64 characters at most."""
    fits = [item for item in items if isinstance(item, Fit)]
    names = [fit.name if fit.converged else f"{fit.name}: no start converged" for fit in fits]
    text = _joined(names or [item.name for item in items if item.name])
    return plain(text if len(text) <= 64 else text[:63].rstrip() + "…")


def interpolated(omega: NDArray, known: NDArray, values: NDArray) -> NDArray:
    """Interpolate `values` (n,) at the sorted `known` (n,) over the logarithm of the frequency, to `omega` (m,)."""
    return np.interp(np.log(omega), np.log(known), values)


def _curve_series(
    items: Sequence[Fit | FrequencyResponse],
    curves: Sequence[Sequence[tuple[str, FrequencyResponse]]],
    names: Sequence[str],
    checksums: Sequence[str],
    pairs: Mapping[str, tuple[str, str]],
    level: float | None,
) -> list[ResponseSeries]:
    """Give every curve the color of its data where these are told apart by color, else one of its item."""
    # One curve that stands for several data sets has the color of none of them.
    shared = any(
        isinstance(item, Fit) and 0 < len(kept) < len(item.responses)
        for item, kept in zip(items, curves, strict=True)
    )
    series = []
    for i, kept in enumerate(curves):
        for checksum, curve in kept:
            palette = COLORS if len(checksums) < 2 else GRAYS
            k = i
            if len(checksums) > 1 and checksum in checksums and not shared:
                palette = COLORS
                k = checksums.index(checksum)
            color = palette[k % len(palette)]
            style = LINE_STYLES[i % len(LINE_STYLES)]
            item = items[i]
            fit = item if isinstance(item, Fit) else None
            band = None if fit is None or level is None else _band(fit, checksum, level)
            series.append(
                ResponseSeries(
                    curve, names[i], color, style, checksum, _pair(curve, pairs), band, fit
                )
            )
    return series


def _band(fit: Fit, checksum: str, level: float) -> ResponseBand | None:
    """Return the band of the curve that was fitted to these data; None where no covariance or no model is known."""
    part = next(k for k, part in enumerate(fit.parts) if part.data.checksum == checksum)
    if fit.known is None:
        return None
    with contextlib.suppress(LookupError):  # a loaded fit of a model that greybox does not include
        band = fit.response_band(level=level, part=part)
        return band if np.any(np.isfinite(band.relative_error)) else None
    return None


def _data_series(
    measured: Mapping[str, tuple[FrequencyResponse, str]], pairs: Mapping[str, tuple[str, str]]
) -> list[ResponseSeries]:
    colors = COLORS if len(measured) > 1 else (DARK,)
    series = []
    for k, (checksum, (data, label)) in enumerate(measured.items()):
        color = colors[k % len(colors)]
        marker = MARKERS[k % len(MARKERS)]
        series.append(
            ResponseSeries(
                data, label, color, marker, checksum, pairs.get(checksum) or _pair(data, pairs)
            )
        )
    return series


def _pairs(items: Sequence[Fit | FrequencyResponse]) -> dict[str, tuple[str, str]]:
    """Return the names of input and output by checksum; the names that data leave out are those of their curve."""
    known = {}
    for part in [part for item in items if isinstance(item, Fit) for part in item.responses]:
        stated = part.curve or part.data
        known[part.data.checksum] = (stated.input, stated.output)
    for item in [item for item in items if isinstance(item, FrequencyResponse)]:
        known.setdefault(item.checksum, (item.input, item.output))
    return {checksum: pair for checksum, pair in known.items() if all(pair)}


def _pair(response: FrequencyResponse, known: Mapping[str, tuple[str, str]]) -> tuple[str, str]:
    """Return the names of input and output; where one is left out, those of the only known pair that fits."""
    stated = response.input, response.output
    fitting = {
        pair
        for pair in known.values()
        if all(a in ("", b) for a, b in zip(stated, pair, strict=True))
    }
    return fitting.pop() if len(fitting) == 1 else stated


def _check(items: Sequence[Fit | FrequencyResponse], labels: Sequence[str]) -> None:
    wrong = [item for item in items if not isinstance(item, Fit | FrequencyResponse)]
    if wrong:
        raise TypeError(f"cannot draw {wrong[0]!r:.80}: give a Fit or a FrequencyResponse.")
    if not items:
        raise ValueError("there is nothing to draw: give at least one Fit or FrequencyResponse.")
    if all(isinstance(item, Fit) and not item.responses for item in items):
        raise ValueError(
            "there is no frequency response to draw: gb.plotting.time_history draws fitted records."
        )
    if labels and len(labels) != len(items):
        raise ValueError(
            f"there are {len(labels)} labels for {len(items)} fits: give one for each."
        )


def _data(item: Fit | FrequencyResponse, name: str) -> list[tuple[FrequencyResponse, str]]:
    """Return the measured responses of an item with their labels."""
    if isinstance(item, Fit):
        return [(part.data, plain(part.name)) for part in item.responses]
    return [] if item.source == "model" else [(item, name)]


def _curves(item: Fit | FrequencyResponse) -> list[tuple[str, FrequencyResponse]]:
    """Return the curves of an item, along omega, each with the checksum of the data that it was fitted to."""
    if isinstance(item, Fit):
        return [
            (part.data.checksum, _sorted(part.curve))
            for part in item.responses
            if part.curve is not None
        ]
    return [("", _sorted(item))] if item.source == "model" else []


def _sorted(curve: FrequencyResponse) -> FrequencyResponse:
    """Return a curve in the order of its frequencies."""
    order = np.argsort(curve.omega)
    return replace(curve, omega=curve.omega[order], response=curve.response[order])


def _distinct(curves: list[tuple[str, FrequencyResponse]]) -> list[tuple[str, FrequencyResponse]]:
    """Leave out the curves that lie on a longer one, as those of several rotors with one model do."""
    kept: list[tuple[str, FrequencyResponse]] = []
    for checksum, curve in sorted(
        curves, key=lambda item: -item[1].omega.max() / item[1].omega.min()
    ):
        if not any(_lies_on(curve, other) for _, other in kept):
            kept.append((checksum, curve))
    return kept


def _lies_on(curve: FrequencyResponse, other: FrequencyResponse) -> bool:
    if (curve.input, curve.output) != (other.input, other.output):
        return False
    inside = (curve.omega >= 0.999 * other.omega.min()) & (
        curve.omega <= 1.001 * other.omega.max()
    )  # rounding
    reference = interpolated(curve.omega, other.omega, other.response)
    return bool(
        np.all(inside & (np.abs(curve.response - reference) <= SAME_CURVE * np.abs(reference)))
    )


def _labels(items: Sequence[Fit | FrequencyResponse]) -> list[str]:
    """Name the items by the model or, if that does not tell them apart, by the problem; else number them."""
    models = [
        _joined(part.label for part in k.parts) if isinstance(k, Fit) else k.name for k in items
    ]
    for names in (models, [item.name for item in items]):
        labels = [
            f"fit of {n}" if isinstance(k, Fit) else n or "data"
            for k, n in zip(items, names, strict=True)
        ]
        if len(set(labels)) == len(labels):
            return labels
    return [
        f"{'fit' if isinstance(item, Fit) else item.name or 'data'} {k}"
        for k, item in enumerate(items, 1)
    ]


def _joined(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(names))
