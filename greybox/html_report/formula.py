"""The formulas of a description, set by matplotlib."""

import io
import re
from base64 import b64encode
from collections.abc import Iterator
from xml.etree.ElementTree import Element

from greybox.html_report.elements import Child, tag

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
