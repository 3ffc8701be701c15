"""Every number in a notebook's text is printed by one of its cells, or stands in their code."""

import json
import re
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
NUMBER = r"(?<![\w.])\d+(?:\.\d+)?(?:e[-+]?\d+)?(?!\w|\.\d)"

# Text that quotes no result: code, headings, equations of the paper, symbols, the level of
# intervals, and references.
NO_RESULT = (
    r"(?s)```.*?```|`[^`]*`",
    r"(?m)^#.*$",
    r"\([1-4]\.\d+\)",
    r"\$[^$]*[A-Za-z\\][^$]*\$",
    r"\b95 %",
    r"(?i)\b(tables?|sections?|figures?|fig\.|notebooks?|chapters?|ADS-)\s*\d[\d.]*((,| and| or| to)\s*\d[\d.]*)*",
)

# The paper's own numbers, which no cell prints.
PAPER = {"01_the_paper": {"10.93", "1002"}, "05_how_far_to_believe_it": {"0.16"}}


def text_numbers(source):
    """Return the numbers of a text as they are written."""
    for pattern in NO_RESULT:
        source = re.sub(pattern, " ", source)
    return re.findall(NUMBER, source)


def stated_but_not_printed(notebook, exempt=frozenset()):
    """Return the numbers of the text that no cell prints, rounded as the text rounds them."""
    printed, text = [], []
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            text.append(source)
            continue
        printed.append(source)
        for output in cell["outputs"]:
            data = output.get("data", {})
            printed += ["".join(output.get("text", ())), "".join(data.get("text/plain", ()))]
            printed.append(re.sub(r"<[^>]*>", " ", "".join(data.get("text/html", ()))))
    values = [float(number) for number in re.findall(NUMBER, "\n".join(printed))]

    def is_printed(number):
        half = 0.5001 * 10.0 ** -len(number.partition(".")[2])
        # A share may be written in percent.
        return any(abs(v * k - float(number)) <= half for v in values for k in (1, 100))

    return [n for n in text_numbers("\n\n".join(text)) if n not in exempt and not is_printed(n)]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_every_number_in_the_text_is_printed_by_a_cell(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert stated_but_not_printed(notebook, PAPER.get(path.stem, frozenset())) == []


def test_a_number_that_no_cell_prints_is_named():
    cells = [
        {"cell_type": "markdown", "source": "# 7\n\nIn (4.26) it costs 0.44, not 0.46, of $x_3$."},
        {"cell_type": "code", "source": "fit", "outputs": [{"text": "cost 0.462"}]},
    ]
    assert stated_but_not_printed({"cells": cells}) == ["0.44"]
    assert stated_but_not_printed({"cells": cells}, {"0.44"}) == []
