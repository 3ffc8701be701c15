"""Numbers with their errors, by the rule of the Particle Data Group and of GUM 7.2.6."""

import math

import pytest

from greybox.data.files.numbers_in_text import is_number, with_error


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


@pytest.mark.parametrize(
    ("cell", "yes"), [("1e3", True), ("nan", True), (" 2 ", True), ("", False), ("1,5", False)]
)
def test_a_cell_is_a_number_or_not(cell, yes):
    assert is_number(cell) == yes


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
