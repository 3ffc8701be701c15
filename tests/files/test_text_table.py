import math

import pytest

from greybox.files.control_characters import printable
from greybox.files.greek_letters import in_greek
from greybox.files.numbers_in_text import is_number, number, with_error
from greybox.files.printed import one_line
from greybox.files.spelling import alternatives, nearest
from greybox.files.text_table import text_table
from greybox.files.wording import counted, listed, some


def test_columns_are_aligned():
    assert text_table(["name", "value"], [["a", "1.5"], ["longer", "10"]]).splitlines() == [
        "name    value",
        "------  -----",
        "a         1.5",
        "longer     10",
    ]


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (3.14159, 0.012, ("3.142", "0.012")),
        (3.14159, 0.0996, ("3.14", "0.10")),
        (1234.5, 38.0, ("1234", "38")),
        (1234.5, 380.0, ("1230", "380")),
        (-0.5, 2.0, ("-0.5", "2.0")),
        (0.0, 0.1, ("0", "0.1")),
        (-1e-17, 0.1, ("0", "0.1")),
        (13.7, 4e5, ("14", "400000")),
        (1.0, math.nan, ("1", "-")),
        (math.nan, 1.0, ("-", "-")),
        (2.0, 0.0, ("2", "-")),
    ],
)
def test_an_error_has_two_digits_and_the_value_ends_with_it(value, error, shown):
    """The rule of the Particle Data Group and of GUM 7.2.6, with two digits."""
    assert with_error(value, error) == shown
    if value > 0:
        assert with_error(-value, error) == (f"-{shown[0]}", shown[1])


def test_very_large_and_small_values_keep_their_digits():
    value, error = with_error(1.23456e-9, 4.5e-12)
    assert float(value) == pytest.approx(1.2346e-9, rel=1e-3)
    assert float(error) == 4.5e-12
    value, error = with_error(1.23456e9, 4.5e5)
    assert float(value) == pytest.approx(1.2346e9, rel=1e-3)
    assert float(error) == 4.5e5
    for sign in (1, -1):
        assert float(with_error(sign * 1.234567e7, 2.0)[0]) == sign * 1.234567e7
        assert with_error(sign * 1.234567e7, 2e3)[0] == f"{sign * 1.23457e7:.6g}"
        assert with_error(sign * 9.876543e6, 2e3)[0] == str(sign * 9876500)


def test_words_and_numbers():
    assert [counted(1, "record"), counted(2, "record")] == ["1 record", "2 records"]
    assert counted(2, "axis", "axes") == "2 axes"
    assert [number(1.23456789), number(math.nan), number(2.0, 3)] == ["1.2346", "-", "2"]


@pytest.mark.parametrize(
    ("cell", "yes"), [("1e3", True), ("nan", True), (" 2 ", True), ("", False), ("1,5", False)]
)
def test_a_cell_is_a_number_or_not(cell, yes):
    assert is_number(cell) == yes


def test_names_are_listed_as_in_a_sentence():
    assert [listed(["a", "b", "c"][:k]) for k in (1, 2, 3)] == ["a", "a and b", "a, b and c"]


def test_of_many_names_the_first_are_given_and_how_many_more_there_are():
    assert some(list("abcd")) == "a, b, c and d"
    assert some(list("abcde")) == "a, b, c, d and e"  # which is no longer than "1 more"
    assert some(list("abcdef")) == "a, b, c, d and 2 more"
    assert some(list("abcdef"), 2) == "a, b and 4 more"


def test_a_representation_is_one_short_line():
    assert one_line(1.0, "a", "b") == "<float a, b>"
    assert one_line(1.0, "two\nlines") == "<float two lines>"
    assert len(one_line(1.0, "long " * 100)) < 120
    assert one_line(1.0, "long " * 100).endswith("...>")


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


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (0.002, 2.0, ("0.0020", "2.0")),  # up to a thousand times the value
        (0.00199, 2.0, ("0.0020", "2.0")),
        (-0.00199, 2.0, ("-0.0020", "2.0")),
        (2.5, 2.4e-9, ("2.5", "2.4e-09")),  # fewer than a billionth is rounding
        (-2.5, 2.4e-9, ("-2.5", "2.4e-09")),
        (12.345678901, 1.26e-6, ("12.3456789", "0.0000013")),
        (12.345678901, 1.26e-7, ("12.3456789", "1.3e-07")),
        (23456789.0, 9.1e3, ("2.34568e+07", "9.1e+03")),
        (0.0, 340.0, ("0", "340")),
        (0.12345678, 2.6e-6, ("0.1234568", "0.0000026")),
        (0.12345678, 2.6e-8, ("0.12345678", "2.6e-08")),
        (0.12345678, 2.6e-7, ("0.12345678", "2.6e-07")),
        (123456.0, 6200.0, ("123500", "6200")),
        (1234567.0, 210000.0, ("1230000", "210000")),
        (5.0, 3.0, ("5.0", "3.0")),
        (3.7, 9.96, ("3.7", "10")),
        (12.4, 340.0, ("12", "340")),
        (-3.04, 340.0, ("-3.0", "340")),
    ],
)
def test_errors_far_larger_and_far_smaller_than_their_value(value, error, shown):
    assert with_error(value, error) == shown


def test_a_misspelled_name_is_recognized():
    known = ["roll", "Pitch", "yaw"]
    assert [nearest(name, known) for name in ("pich", "ROL", "thrust")] == ["Pitch", "roll", None]
    assert alternatives("yew", known) == "roll, Pitch, yaw: did you mean 'yaw'?"
    assert alternatives("thrust", known) == "roll, Pitch, yaw."
    assert alternatives("thrust", []) == "none."


def test_names_of_greek_letters():
    names = "theta", "u_phi", "Omega_x", "lambda_0", "PI", "thetas", "fitted alpha_1"
    assert [*map(in_greek, names)] == ["θ", "u_φ", "Ω_x", "λ_0", "PI", "thetas", "fitted α_1"]


def test_the_longest_representation_is_119_characters():
    assert one_line(1.0, "x" * 111) == f"<float {'x' * 111}>"
    assert one_line(1.0, "x" * 112) == f"<float {'x' * 108}...>"


def test_counts_may_be_numbers_of_any_kind():
    assert [counted(1.0, "s"), counted(0, "row"), counted(1e6, "row"), counted(10**6, "row")] == [
        "1 s", "0 rows", "1e+06 rows", "1000000 rows",
    ]  # fmt: skip
