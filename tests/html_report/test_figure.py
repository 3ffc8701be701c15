"""Figures on the page: their numbers as JSON."""

import json

import numpy as np
import pytest

from greybox.html_report.figure import figure_element, figure_grid
from greybox.plotting.figure import Figure, Panel, Series


def values(figure):
    return json.loads(figure_element(figure).find("div").get("data-figure"))


def test_numbers_keep_the_digits_that_zooming_needs():
    clock = 1.7e9 + 0.01 * np.arange(5)
    line = Series("a", "line", clock, np.array([1 / 3, np.nan, np.inf, 2.0, 1e-9]))
    region = Series("", "regions", clock, clock)
    (panel,) = values(Figure("a", "x", [Panel("y", [line, region])]))["panels"]
    (series,) = panel["series"]
    assert np.diff(series["x"]) == pytest.approx(np.full(4, 0.01), rel=1e-3)
    assert series["y"] == [0.33333, None, None, 2, 1e-9]
    assert (series["name"], series["kind"], "low" in series) == ("a", "line", False)


def test_wide_figures_and_a_figure_alone_take_the_whole_width():
    usual, wide = Figure("a", "x", []), Figure("b", "x", [], is_wide=True)
    assert [element.get("class") for element in figure_grid([usual, wide])] == [None, "wide"]
    assert [element.get("class") for element in figure_grid([usual])] == ["wide"]


def test_limits_of_axes_are_passed_on():
    assert values(Figure("a", "x", [], limits=(0.0, 3.0)))["limits"] == [0, 3]
    assert values(Figure("a", "x", []))["limits"] is None
    panels = [Panel("a", [], limits=(0.5, np.inf)), Panel("b", [], limits=(0.0, 123456.7))]
    limits = [panel["limits"] for panel in values(Figure("a", "x", panels))["panels"]]
    assert limits == [[0.5, None], [0, 123460]]


def test_the_caption_has_title_and_sentences():
    caption = figure_element(Figure("Bode diagram", "x", [], caption="Shaded.")).find("figcaption")
    assert "".join(caption.itertext()) == "Bode diagram Shaded."
