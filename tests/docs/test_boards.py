"""The table of boards has the numbers of the stored outputs."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "boards.md").read_text(encoding="utf-8")
TABLE, _, SECOND = PAGE.partition("\n\n| board | standard errors")
BOARDS = re.findall(r"^\| \[([^]]+)\]\(#([\w-]+)\)(.*)\| ([^|]+) \|$", TABLE, re.MULTILINE)
SECTIONS = {name: section for name, section, _, _ in BOARDS}
STARTS = re.findall(r"^\| (\w[\w ,-]+) \|[^|]+\|([^|]+)\|[^|]+\|$", SECOND, re.MULTILINE)


def stored_output(section):
    (text,) = (
        part
        for part in PAGE.split("\n## ")[1:]
        if part.partition("\n")[0].lower().replace(" ", "-").replace("'", "") == section
    )
    (path,) = re.findall(r"`(benchmarks/results/\w+\.txt)`", text)
    (command,) = re.findall(r"`python (benchmarks/(?:boards/)?\w+\.py) ", text)
    assert (ROOT / command).exists()
    return (ROOT / path).read_text(encoding="utf-8")


@pytest.mark.parametrize("board", BOARDS, ids=[name for name, *_ in BOARDS])
def test_the_numbers_are_those_of_the_stored_output(board):
    _, section, cells, date = board
    stored = stored_output(section)
    assert date in "".join(stored.splitlines()[:2])
    numbers = re.findall(r"\d+\.\d+", " ".join(cells.split("|")[2:]))
    assert len(numbers) >= 3
    for number in numbers:
        assert re.search(rf"(?<![\d.]){re.escape(number)}(?!\d)", stored), number


@pytest.mark.parametrize(("name", "starts"), STARTS, ids=[name for name, _ in STARTS])
def test_the_shares_of_starts_are_those_of_the_stored_output(name, starts):
    stored = stored_output(SECTIONS[name])
    for reached, to, run in re.findall(r"(\d+)(?: to (\d+))? of (\d+)", starts):
        for share in (reached, to or reached):
            assert re.search(rf"\b{share} of {run}\b", stored), (share, run)


def test_both_tables_have_all_boards():
    assert {name for name, _ in STARTS} == {*SECTIONS}
