"""Figures on the page: elements with the numbers that the script `page.js` draws."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from greybox.html_report.elements import tag
from greybox.plotting.figure import Figure, Series

DIGITS = 5  # of numbers in a figure: a pixel is a thousandth of a panel
COLUMNS = 600  # of a line on the page, two pixels wide; a line then takes about 18 kB


def figure_grid(figures: Sequence[Figure]) -> Element:
    """Return figures for the page, side by side where there is room."""
    is_alone = len(figures) == 1
    return tag("div", [figure_element(figure, is_alone) for figure in figures], class_="figures")


def figure_element(figure: Figure, is_alone: bool = False) -> Element:
    """Return a figure; the script draws into the element of class ``plot``."""
    # In an attribute, which is escaped: a name in the data could end a script element.
    options = {"ensure_ascii": False, "separators": (",", ":")}
    data = json.dumps(figure, allow_nan=False, default=_plain, **options)
    caption = tag("figcaption", tag("strong", figure.title), f" {figure.caption}".rstrip())
    wide = "wide" if figure.is_wide or is_alone else None
    return tag("figure", caption, tag("div", class_="plot", data_figure=data), class_=wide)


def _plain(item: Any) -> Any:
    """Return numbers as a list, anything else by the names of its attributes."""
    if isinstance(item, np.ndarray):
        values = np.asarray(item, dtype=float)
        finite = values[np.isfinite(values)]
        span = float(np.ptp(finite)) if finite.size else 0.0
        return [_number(value, span) for value in values.tolist()]
    if isinstance(item, Series) and item.kind == "regions":
        # NaN ends an outline. Twelve of its 48 vertices look round, in a quarter of the space.
        ends = np.isnan(item.x)
        visible = ends | (np.cumsum(~ends) % 4 == 0)
        item = replace(item, x=item.x[visible], y=item.y[visible])
    return {name: value for name, value in vars(item).items() if value is not None}


def _number(value: float, span: float) -> float | None:
    """Return a number with the digits that a figure of this span needs, None if not finite."""
    if not math.isfinite(value):
        return None
    # Five digits of a clock time in seconds would be all alike: far from zero keep more of them.
    digits = math.ceil(math.log10(abs(value) / span)) if 0 < span < abs(value) else 0
    return float(f"{value:.{DIGITS + digits}g}")
