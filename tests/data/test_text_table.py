"""Numbers, lists and values as a person reads them."""

import pytest

from greybox.data.text_table import counted, listed, one_line, with_error


def test_names_are_listed_as_in_a_sentence():
    assert [listed(["a", "b", "c"][:k]) for k in (1, 2, 3)] == ["a", "a and b", "a, b and c"]


def test_things_are_counted_in_the_singular_and_in_the_plural():
    assert [counted(k, "minimum", "minima") for k in (0, 1, 2)] == ["0 minima", "1 minimum", "2 minima"]
    assert counted(2, "window") == "2 windows"


@pytest.mark.parametrize(
    ("value", "error", "expected"),
    [
        (1.23456, 0.0123, ("1.235", "0.012")),
        (123456, 1234, ("123500", "1200")),
        (0.5, float("nan"), ("0.5", "-")),
        (0.5, 0.0, ("0.5", "-")),
    ],
)
def test_a_value_is_rounded_to_its_error(value, error, expected):
    assert with_error(value, error) == expected


def test_a_representation_is_one_short_line():
    assert one_line(1.0, "a", "b") == "<float a, b>"
    assert one_line(1.0, "two\nlines") == "<float two lines>"
    assert len(one_line(1.0, "long " * 100)) < 120
    assert one_line(1.0, "long " * 100).endswith("...>")
