"""Elements of the page: the tree of the standard library, which escapes texts and attributes.

The formulas of a description, set by matplotlib.

Figures on the page: elements with the numbers that the script `page.js` draws.

Tables of the page; its script can sort them.
"""

import io
import json
import math
import re
from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any
from xml.etree.ElementTree import Element, tostring

import numpy as np

from greybox.assessment import printed
from greybox.assessment.identifiability import ERROR_GUIDELINE, INSENSITIVITY_GUIDELINE
from greybox.assessment.result import Fit
from greybox.data.files.escapes import html_text
from greybox.data.files.frozen_values import frozen
from greybox.data.files.numbers_in_text import is_number, number, percent, with_error
from greybox.reporting.plotting.figure import Figure, Series

Child = Element | str | Iterable["Child"]
"""Content of an element: elements, text, nothing, or several of these."""


def tag(name: str, *children: Child, **attributes: Any) -> Element:
    """Return an element. Attributes that are None or False are left out.

    In names of attributes hyphens replace underscores; one at the end, as in ``class_``, is left
    out.
    """
    # Texts come from files of strangers. The tree escapes markup, and `html_text` the control
    # characters that HTML does not allow.
    element = Element(name)
    for key, value in attributes.items():
        if value is not None and value is not False:
            text = "" if value is True else str(value)
            element.set(key.rstrip("_").replace("_", "-"), html_text(text))
    _append(element, children)
    return element


def html(element: Element) -> str:
    """Return an element as HTML."""
    return tostring(element, encoding="unicode", method="html")


def _append(element: Element, children: Child) -> None:
    if isinstance(children, str):
        text = html_text(children)
        # This tree keeps a text in the element before it.
        if len(element):
            element[-1].tail = (element[-1].tail or "") + text
        else:
            element.text = (element.text or "") + text
    elif isinstance(children, Element):
        element.append(children)
    else:
        for child in children:
            _append(element, child)


# Backticks, and the arguments of a class, which are not part of its equation.
OMITTED = r"(?s)`|\n\n(Parameters|Raises)\n-.+?(?=\n\n|$)"


def description(text: str) -> Iterator[Element]:
    """Yield paragraphs with the formulas between dollar signs as images, as LaTeX writes them."""
    for paragraph in re.sub(OMITTED, "", text).split("\n\n"):
        yield tag("p", with_formulas(paragraph))


def with_formulas(text: str) -> list[Child]:
    """Return a text with the formulas between dollar signs as images."""
    pieces = re.split(r"(?s)(\$\$.+?\$\$|\$.+?\$)", text)
    return [_formula(piece) if k % 2 else piece for k, piece in enumerate(pieces)]


def _formula(piece: str) -> Child:
    from matplotlib import rc_context  # noqa: PLC0415  (takes a third of a second)
    from matplotlib.mathtext import math_to_image  # noqa: PLC0415

    is_display = piece.startswith("$$")
    formula = " ".join(piece.strip("$").split())
    # As LaTeX does between two dollar signs.
    drawn = formula.replace(r"\frac", r"\dfrac") if is_display else formula
    image = io.BytesIO()
    try:
        with rc_context({"savefig.transparent": True, "svg.fonttype": "path"}):
            math_to_image(f"${drawn}$", image, format="svg")
    except ValueError:  # what matplotlib cannot set, such as matrices
        return tag("code", formula)
    source = "data:image/svg+xml;base64," + b64encode(image.getvalue()).decode()
    return tag("img", src=source, alt=formula, class_="display" if is_display else None)


DIGITS = 5  # of numbers in a figure: a pixel is a thousandth of a panel
COLUMNS = 600  # of a line on the page, two pixels wide; a line then takes about 18 kB


def figure_grid(figures: Sequence[Figure]) -> Element:
    """Return figures for the page, side by side where there is room."""
    is_alone = len(figures) == 1
    return tag("div", [figure_element(figure, is_alone) for figure in figures], class_="figures")


def figure_element(figure: Figure, is_alone: bool = False) -> Element:
    """Return a figure; the script draws into the element of class ``plot``."""
    # In an attribute, which is escaped: a name in the data could end a script element.
    data = json.dumps(
        figure, allow_nan=False, default=_plain, ensure_ascii=False, separators=(",", ":")
    )
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


@frozen
class Cell:
    """Text of a cell, the number by which it is sorted, and the class that marks it."""

    text: Child
    value: float | None = None
    mark: str = ""


def table(header: Sequence[str], rows: Sequence[Sequence[Cell]]) -> Element:
    """Return a table; columns of numbers are flush right."""
    # One number makes a column of numbers: dashes stand for those that are not known.
    is_number = [any(row[k].value is not None for row in rows) for k in range(len(header))]
    head = [
        tag("th", text, scope="col", class_="number" if right else None)
        for text, right in zip(header, is_number, strict=True)
    ]
    body = tag("tbody", [tag("tr", map(_cell, row, is_number)) for row in rows])
    return tag(
        "div",
        tag("table", tag("thead", tag("tr", head)), body, class_="sortable"),
        class_="scroll",
        tabindex="0",
    )


def parameter_table(fit: Fit) -> Element:
    """Return the table of all quantities; for a failed fit, the last values of its best run."""
    header, rows, left = printed.parameter_table(fit)
    # A unit of 1 is a text, too.
    cells = [
        [Cell(x, float(x) if is_number(x) and k not in left else None) for k, x in enumerate(row)]
        for row in rows
    ]
    for row, (*_, about) in zip(cells, rows, strict=True):
        row[-1] = Cell(with_formulas(about) if "$" in about else about)
    if fit.converged:
        header = [*header[:3], "95 % interval", "CR, %", "insensitivity, %", *header[3:]]
        intervals = fit.interval(0.95)
        shares = {}
        with suppress(ValueError):  # the fit has no standard errors
            judged = fit.identifiability
            shares = dict(
                zip(judged.names, np.array([judged.error, judged.insensitivity]).T, strict=True)
            )
        for row, (name, *_) in zip(cells, rows, strict=True):
            low, high = intervals.get(name, (math.nan, math.nan))
            error, insensitivity = shares.get(name, (math.nan, math.nan))
            row[3:3] = [
                Cell(_interval(low, high), low),
                _share(error, ERROR_GUIDELINE),
                _share(insensitivity, INSENSITIVITY_GUIDELINE),
            ]
    return table(header, cells)


def number_cell(value: float | None, digits: int = 5) -> Cell:
    """Return the cell of a number; a dash for an unknown one."""
    if value is None or not math.isfinite(value):
        return Cell("–")
    return Cell(number(value, digits), value)


def _share(share: float, guideline: float) -> Cell:
    if math.isnan(share):
        return Cell("–")
    text = percent(share)
    return Cell(f"{text} !", share, "doubt") if share > guideline else Cell(text, share)


def _interval(low: float, high: float) -> str:
    if not (math.isfinite(low) and math.isfinite(high)):
        return "–"
    # A quarter of a 95 % interval is about one standard error, which decides the digits.
    return " to ".join(with_error(end, (high - low) / 4)[0] for end in (low, high))


def _cell(cell: Cell, is_number: bool) -> Element:
    text = cell.text
    classes = [cell.mark, "number" if is_number else ""]
    # Numbers are never broken into lines; sentences must be, or they would widen the page.
    if isinstance(text, str):
        if len(text) > 24:  # characters from which a text is broken into lines
            classes.append("prose")
        if is_number:
            text = text.replace("-", "−").replace("inf", "∞")

    # The script sorts by this number, not by the rounded text.
    value = f"{cell.value:.12g}" if cell.value is not None and math.isfinite(cell.value) else None
    return tag("td", text, class_=" ".join(filter(None, classes)) or None, data_value=value)
