"""Figures on the page: their numbers as JSON."""

import json

import numpy as np
import pytest

from greybox.reporting.html_report.elements import figure_element, figure_grid
from greybox.reporting.plotting.figure import Figure, Panel, Series


def values(figure):
    return json.loads(figure_element(figure).find("div").get("data-figure"))


def test_numbers_keep_the_digits_that_zooming_needs():
    clock = 1.7e9 + 0.01 * np.arange(5)
    line = Series("a", "line", clock, np.array([1 / 3, np.nan, np.inf, 2.0, 1e-9]))
    outline = np.array([np.nan, *range(8), np.nan, *range(10, 18)])
    region = Series("", "regions", outline, outline)
    (panel,) = values(Figure("a", "x", [Panel("y", [line, region])]))["panels"]
    series, thinned = panel["series"]
    assert thinned["x"] == thinned["y"] == [None, 3, 7, None, 13, 17]
    assert np.diff(series["x"]) == pytest.approx(np.full(4, 0.01), rel=1e-3)
    assert series["y"] == [0.33333, None, None, 2, 1e-9]
    assert (series["name"], series["kind"], "low" in series) == ("a", "line", False)


def test_wide_figures_and_a_figure_alone_take_the_whole_width():
    usual, wide = Figure("a", "x", []), Figure("b", "x", [], is_wide=True)
    assert [element.get("class") for element in figure_grid([usual, wide])] == [None, "wide"]
    assert [element.get("class") for element in figure_grid([usual])] == ["wide"]


def test_limits_of_axes_are_passed_on():
    assert values(Figure("a", "x", [], limits=(0.0, 3.0)))["limits"] == [0, 3]
    assert "limits" not in values(Figure("a", "x", []))
    (panel,) = values(Figure("a", "x", [Panel("b", [], limits=(0.5, 2.0))]))["panels"]
    assert panel["limits"] == [0.5, 2]


def test_the_caption_has_title_and_sentences():
    caption = figure_element(Figure("Bode diagram", "x", [], caption="Shaded.")).find("figcaption")
    assert "".join(caption.itertext()) == "Bode diagram Shaded."
