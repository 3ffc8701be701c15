"""Whole figures: what they say, where they are shown and saved."""

import subprocess
import sys

import numpy as np
import pytest
from drawn_lines import curves, points

import greybox as gb


def test_a_fit_that_did_not_converge_shows_its_data_and_says_so(failed):
    for draw in (gb.plotting.nyquist, gb.plotting.bode):
        axes = draw(failed)[0]
        assert (len(points(axes)), len(curves(axes))) == (1, 0)
        assert "pitch: no start converged" in (axes.get_title(), axes.figure.get_suptitle())
    assert gb.plotting.starts(failed).get_title() == "None of 8 starts converged"
    assert gb.plot(failed).get_suptitle() == "pitch: no start converged"


def test_figures_can_be_saved(tmp_path, pitch, failed):
    figures = [gb.plotting.nyquist(pitch)[0].figure, gb.plotting.starts(failed).figure]
    for figure, kind in zip(figures, ("pdf", "svg"), strict=True):
        figure.savefig(tmp_path / f"figure.{kind}")
        assert (tmp_path / f"figure.{kind}").stat().st_size > 1000


def test_frequencies_are_in_hertz_on_request(pitch):
    usual, hertz = gb.plotting.bode(pitch), gb.plotting.bode(pitch, hz=True)
    for one, other in zip(usual, hertz, strict=True):
        for line, scaled in zip(one.get_lines(), other.get_lines(), strict=True):
            x = line.get_xdata()
            # A line over the whole width is placed by the width.
            factor = 1 if line.get_transform() != one.transData else 2 * np.pi
            assert np.allclose(scaled.get_xdata(), np.divide(x, factor), equal_nan=True)
            assert np.array_equal(scaled.get_ydata(), line.get_ydata(), equal_nan=True)
    assert hertz[-1].get_xlabel() == "Frequency, Hz"

    # Real parts, starts and times stay what they are.
    labels = [ax.get_xlabel() for ax in gb.plot(pitch, hz=True).axes]
    assert "Frequency, Hz" in labels
    assert not any("rad/s" in label for label in labels)
    assert gb.plotting.starts(pitch).get_xlabel() in labels


def test_points_of_the_nyquist_diagram_are_numbered_in_hertz_on_request(pitch):
    [plane] = gb.plotting.nyquist(pitch, hz=True)
    first, *others = [text.get_text() for text in plane.texts]
    assert first.endswith(" Hz")
    for number in (first.removesuffix(" Hz"), *others):
        ratio = float(number) * 2 * np.pi / pitch.parts[0].data.omega
        assert np.abs(ratio - 1).min() < 0.006


def run(code):
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.strip()


def test_a_notebook_shows_the_figure_without_pyplot():
    pytest.importorskip("IPython")
    code = (
        "import sys, greybox as gb\n"
        "print('matplotlib' in sys.modules)\n"
        "from IPython.core.formatters import DisplayFormatter\n"
        "ax, = gb.plotting.nyquist(gb.FrequencyResponse([1, 2], [1, 1j]))\n"
        "shown, _ = DisplayFormatter().format(ax.figure)\n"
        "print(shown['image/png'][1:4].decode(), 'matplotlib.pyplot' in sys.modules)"
    )
    assert run(code).split() == ["False", "PNG", "False"]
