"""Elements of the page: texts, formulas, figures and tables.

An element is one of the standard library's XML tree, which escapes texts and attributes. Formulas
are images by matplotlib. A figure has the numbers that the script `page.js` draws; the script also
sorts tables.
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
    """Append texts and elements to an element."""
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


# Parts of a docstring that the page omits: backticks, and the arguments of a class, which are not
# part of its equation.
OMITTED = r"(?s)`|\n\n(Parameters|Raises)\n-.+?(?=\n\n|$)"


def description(text: str) -> Iterator[Element]:
    """Yield paragraphs with the formulas between dollar signs as images, as LaTeX writes them."""
    for paragraph in re.sub(OMITTED, "", text).split("\n\n"):
        yield tag("p", with_formulas(paragraph))


def with_formulas(text: str) -> list[Child]:
    """Return a text with the formulas between dollar signs as images."""
    # Texts and formulas alternate.
    pieces: list[Child] = [*re.split(r"(?s)(\$\$.+?\$\$|\$.+?\$)", text)]
    pieces[1::2] = [_formula(str(piece)) for piece in pieces[1::2]]
    return pieces


def _formula(piece: str) -> Child:
    """Return a formula, between dollar signs, as an image; as code if matplotlib cannot set it."""
    from matplotlib import rc_context  # noqa: PLC0415  (takes a third of a second)
    from matplotlib.mathtext import math_to_image  # noqa: PLC0415

    is_display = piece.startswith("$$")
    formula = " ".join(piece.strip("$").split())
    # Between two dollar signs, LaTeX writes large fractions.
    drawn = formula.replace(r"\frac", r"\dfrac") if is_display else formula
    image = io.BytesIO()
    try:
        with rc_context({"savefig.transparent": True, "svg.fonttype": "path"}):
            math_to_image(f"${drawn}$", image, format="svg")
    except ValueError:  # what matplotlib cannot set, such as matrices
        return tag("code", formula)
    source = "data:image/svg+xml;base64," + b64encode(image.getvalue()).decode()
    return tag("img", src=source, alt=formula, class_="display" if is_display else None)


# Significant digits of numbers in a figure: a pixel is a thousandth of a panel.
DIGITS = 5
# Columns of a line on the page, two pixels wide; a line then takes about 18 kB.
COLUMNS = 600
# Letters above which the text of a cell is broken into lines.
LONG_TEXT = 24


def figure_grid(figures: Sequence[Figure]) -> Element:
    """Return figures for the page, side by side where there is room."""
    is_alone = len(figures) == 1
    return tag("div", [figure_element(figure, is_alone) for figure in figures], class_="figures")


def figure_element(figure: Figure, is_alone: bool = False) -> Element:
    """Return a figure; the script draws into the element of class ``plot``."""
    # The data are in an attribute, which is escaped: a name in them could end a script element.
    data = json.dumps(
        figure, allow_nan=False, default=_plain, ensure_ascii=False, separators=(",", ":")
    )
    caption = tag("figcaption", tag("strong", figure.title), f" {figure.caption}".rstrip())
    wide = "wide" if figure.is_wide or is_alone else None
    return tag("figure", caption, tag("div", class_="plot", data_figure=data), class_=wide)


def _plain(item: Any) -> Any:
    """Return an array as a list of numbers, and other values as a mapping of their attributes."""
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
    # The first five digits of clock times in seconds are the same: far from zero, more are kept.
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
    # One number makes a column of numbers, in which a dash is an unknown number.
    are_numbers = [any(row[k].value is not None for row in rows) for k in range(len(header))]
    head = []
    for text, are_numbers_here in zip(header, are_numbers, strict=True):
        head.append(tag("th", text, scope="col", class_="number" if are_numbers_here else None))
    body = tag("tbody", [tag("tr", map(_cell, row, are_numbers)) for row in rows])
    return tag(
        "div",
        tag("table", tag("thead", tag("tr", head)), body, class_="sortable"),
        class_="scroll",
        tabindex="0",
    )


def parameter_table(fit: Fit) -> Element:
    """Return the table of all quantities; for a failed fit, the last values of its best run."""
    parameters = printed.parameter_table(fit)
    rows = []
    for texts in parameters.rows:
        row = []
        for k, text in enumerate(texts):
            # Columns that are flush left are texts, also a unit of 1.
            is_value = is_number(text) and k not in parameters.left
            row.append(Cell(text, float(text) if is_value else None))
        about = texts[-1]
        row[-1] = Cell(with_formulas(about) if "$" in about else about)
        rows.append(row)
    header = parameters.header
    if fit.converged:
        # The further columns are behind name, estimate and error.
        header = [*header[:3], "95 % interval", "CR, %", "insensitivity, %", *header[3:]]
        judgments = _judgments(fit)
        for row, texts in zip(rows, parameters.rows, strict=True):
            name = texts[0]
            # The last row may count the quantities that are left out.
            row[3:3] = judgments.get(name, [Cell("–", math.nan), Cell("–"), Cell("–")])
    return table(header, rows)


def _judgments(fit: Fit) -> dict[str, list[Cell]]:
    """Return cells for the interval, the error and the insensitivity of every quantity."""
    errors: dict[str, float] = {}
    insensitivities: dict[str, float] = {}
    with suppress(ValueError):  # the fit has no standard errors
        judged = fit.identifiability
        errors = dict(zip(judged.names, judged.error.tolist(), strict=True))
        insensitivities = dict(zip(judged.names, judged.insensitivity.tolist(), strict=True))
    intervals = fit.interval(0.95)
    cells = {}
    for quantity in fit.quantities:
        name = quantity.name
        low, high = intervals.get(name, (math.nan, math.nan))
        cells[name] = [
            Cell(_interval(low, high), low),
            _share(errors.get(name, math.nan), ERROR_GUIDELINE),
            _share(insensitivities.get(name, math.nan), INSENSITIVITY_GUIDELINE),
        ]
    return cells


def number_cell(value: float | None, digits: int = 5) -> Cell:
    """Return the cell of a number; a dash for an unknown one."""
    if value is None or not math.isfinite(value):
        return Cell("–")
    return Cell(number(value, digits), value)


def _share(share: float, guideline: float) -> Cell:
    """Return the cell of a relative error, marked beyond its guideline."""
    if math.isnan(share):
        return Cell("–")
    text = percent(share)
    return Cell(f"{text} !", share, "doubt") if share > guideline else Cell(text, share)


def _interval(low: float, high: float) -> str:
    """Return a 95 % interval as text."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return "–"
    # A quarter of a 95 % interval is about one standard error, which decides the digits.
    return " to ".join(with_error(end, (high - low) / 4)[0] for end in (low, high))


def _cell(cell: Cell, is_number: bool) -> Element:
    """Return the element of a cell, in a column of numbers or of texts."""
    text = cell.text
    classes = [cell.mark, "number" if is_number else ""]
    # Numbers are never broken into lines; sentences must be, or they would widen the page.
    if isinstance(text, str):
        if len(text) > LONG_TEXT:
            classes.append("prose")
        if is_number:
            text = text.replace("-", "−").replace("inf", "∞")

    # The script sorts by this number, not by the rounded text.
    value = f"{cell.value:.12g}" if cell.value is not None and math.isfinite(cell.value) else None
    return tag("td", text, class_=" ".join(filter(None, classes)) or None, data_value=value)
