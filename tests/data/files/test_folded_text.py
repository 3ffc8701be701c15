"""Long lines of answers."""

from itertools import pairwise

import pytest

from greybox.data.files.folded_text import folded

WORDS = " ".join(f"word{k}" for k in range(40))


@pytest.mark.parametrize(
    ("line", "hanging"),
    [
        (WORDS, 2),
        ("  " + WORDS, 4),
        ("  data       " + WORDS, 13),
        ("ATT  14058  57.17  " + WORDS, 19),
        ("x" * 68 + "  " + WORDS, 70),
    ],
)
def test_a_long_line_is_folded_below_its_last_cell(line, hanging):
    lines = folded(line).split("\n")
    assert max(map(len, lines)) <= 100
    assert all(len(part) - len(part.lstrip()) == hanging for part in lines[1:])
    assert "".join(lines).replace(" ", "") == line.replace(" ", "")
    # No word of the next line would have fitted.
    for part, following in pairwise(lines):
        assert len(part) + 1 + len(following.split()[0]) > 100


def test_what_fits_and_commands_stay():
    command = "  greybox margins " + "a" * 90 + " --log b.BIN"
    # Too far to the right for a column of its own.
    row = "x" * 69 + "  " + WORDS
    text = f"a  short line\n\n{command}\n{row}\nsaved {WORDS}\n" + "y" * 120
    assert folded(text) == text
    assert folded("-" * 50 + "  " + "-" * 80) == "-" * 50 + "  " + "-" * 48
