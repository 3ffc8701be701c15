"""Cells of tables."""

import math

import pytest

from greybox.html_report.tables import number_cell


@pytest.mark.parametrize("value", [None, math.nan, math.inf])
def test_what_is_not_known_is_a_dash(value):
    assert number_cell(value).text == "–"
    assert number_cell(value).value is None
