"""The table of boards has the numbers of the stored outputs."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "boards.md").read_text(encoding="utf-8")
TABLE = PAGE.partition("\n\n| board | standard errors")[0]
ROWS = re.findall(r"^\| \[[^]]+\]\(#([\w-]+)\)(.*)\|[^|]+\|$", TABLE, re.MULTILINE)


@pytest.mark.parametrize(("section", "cells"), ROWS, ids=[section for section, _ in ROWS])
def test_the_numbers_are_those_of_the_stored_output(section, cells):
    (text,) = (
        part
        for part in PAGE.split("\n## ")[1:]
        if part.partition("\n")[0].lower().replace(" ", "-").replace("'", "") == section
    )
    (path,) = re.findall(r"`(benchmarks/results/\w+\.txt)`", text)
    (command,) = re.findall(r"`python (benchmarks/(?:boards/)?\w+\.py) ", text)
    assert (ROOT / command).exists()
    stored = (ROOT / path).read_text(encoding="utf-8")
    numbers = re.findall(r"\d+\.\d+", " ".join(cells.split("|")[2:]))
    assert len(numbers) >= 3
    for number in numbers:
        assert re.search(rf"(?<![\d.]){re.escape(number)}(?!\d)", stored), number
