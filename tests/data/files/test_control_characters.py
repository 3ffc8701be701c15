"""Control characters in names and texts."""

import pytest

from greybox.data.files.control_characters import printable
from greybox.data.files.text_table import text_table


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("ω, rad/s² ± 3° 漢", "ω, rad/s² ± 3° 漢"),
        ("a\u00a0b", "a\u00a0b"),
        ("\x1b[2J\x07\x7f\x9b", r"\x1b[2J\x07\x7f\x9b"),
        ("a\nb\tc\r", r"a\nb\tc\r"),
        ("\u202egnp.exe\u2028\ufeff", r"\u202egnp.exe\u2028\ufeff"),
        ("half \ud800", r"half \ud800"),
    ],
)
def test_control_characters_are_written_out_and_nothing_else(text, expected):
    assert printable(text) == expected
    assert printable(printable(text)) == expected


def test_lines_are_kept_where_a_text_has_some():
    assert printable("a\n\tb\x1b", keep="\n\t") == "a\n\tb\\x1b"
    assert text_table(["a"], [["x\x1b[2J"]]).splitlines()[-1] == r"x\x1b[2J"
