"""Figures of loops and of safe gains have the numbers of their answers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import greybox as gb
from greybox.models.rate import BasicRate
from greybox.reporting.plotting.gains import comparison_figures, gains_figure
from greybox.reporting.plotting.loops import loop_figures

pytestmark = pytest.mark.usefixtures("few_draws")


class RateLoop(gb.Controller):
    """Proportional control of the rate."""

    inputs, outputs = ("p",), ("u",)
    K_P = gb.Parameter(0.05, bounds=(0, 10))

    def update(self, x, u, p):
        return (), (p.K_P * (u.reference - u.p),)


@pytest.fixture(scope="module")
def fit():
    omega = np.geomspace(2, 60, 30)
    exact = gb.frequency_response(BasicRate(), {}, omega)
    errors = 1 + 0.03 * np.random.default_rng(0).normal(size=(2, 30)).T @ [1, 1j]
    data = gb.FrequencyResponse(omega, exact.response * errors, "u", "p")
    return gb.fit(gb.Problem(BasicRate(), data), starts=2, progress=False)


@pytest.mark.parametrize("gain", [1e-6, 0.01])
def test_a_loop_whose_gain_never_comes_near_one_is_drawn(fit, gain):
    answer = gb.margins(fit, RateLoop({"K_P": gain * 0.05}))
    bode, *_ = loop_figures(answer)
    drawn = bode.panels[0].series
    (estimate,) = [series for series in drawn if series.name == "estimate"]
    assert estimate.x.size > 10
    assert np.all(np.isfinite(estimate.y))


def test_the_loop_crosses_where_its_margins_say_within_its_band(fit):
    answer = gb.margins(fit, RateLoop())
    bode, nichols, nyquist, sensitivity, step = loop_figures(answer)
    band, curve, *_ = bode.panels[0].series
    assert np.interp(answer["crossover"].omega, curve.x, curve.y) == pytest.approx(0, abs=0.01)
    assert np.all((band.low <= curve.y) & (curve.y <= band.high))
    assert np.interp(answer["crossover"].low, band.x, band.low) == pytest.approx(0, abs=0.1)
    for figure, critical in ((nichols, (-180, 0)), (nyquist, (-1, 0))):
        (point,) = (s for s in figure.panels[0].series if s.name == "critical point")
        assert (point.x[0], point.y[0]) == critical
    curve = step.panels[0].series[1]
    assert curve.y.max() == pytest.approx(1 + answer["overshoot"].value / 100)
    peak = next(s for s in sensitivity.panels[0].series if s.kind == "line").y.max()
    assert peak == pytest.approx(answer["disturbance rejection peak"].value, abs=0.05)
    assert gb.plotting.loop(answer).size == 6


def test_margins_are_marked_with_their_intervals_where_the_loop_crosses(fit):
    answer = gb.margins(fit, RateLoop())
    phase, gain = answer["phase margin"], answer["gain margin"]
    bode, nichols, nyquist, *_ = loop_figures(answer)

    def bars(panel):
        (mark,) = (s for s in panel.series if s.kind == "points" and s.low is not None)
        return mark.x[0], mark.y[0], mark.low[0], mark.high[0]

    expected = gain.omega, -gain.value, -gain.high, -gain.low
    assert bars(bode.panels[0]) == pytest.approx(expected)
    expected = phase.omega, phase.value - 180, phase.low - 180, phase.high - 180
    assert bars(bode.panels[1]) == pytest.approx(expected)
    for margin, panel in (
        (gain, bode.panels[0]),
        (phase, nichols.panels[0]),
        (gain, nyquist.panels[0]),
    ):
        (name,) = {s.name for s in panel.series if s.name.startswith(margin.name)}
        assert f"{margin.value:.3g} ({margin.low:.3g} to {margin.high:.3g})" in name
    # The modulus margin touches the curve of the loop, the phase margin lies on the unit circle.
    series = nyquist.panels[0].series
    circle = next(s for s in series if s.name.startswith("modulus margin"))
    curve = next(s for s in series if s.name == "estimate")
    radius = np.hypot(circle.x + 1, circle.y)
    assert np.hypot(curve.x + 1, curve.y).min() == pytest.approx(radius.min(), rel=0.01)
    arc = next(s for s in series if s.name.startswith("phase margin"))
    assert np.hypot(arc.x, arc.y) == pytest.approx(1)
    angle = np.degrees(np.arctan2(arc.y[-1], arc.x[-1]))
    assert angle == pytest.approx(phase.value - 180, abs=0.01)
    # The axis shows the crossings, and not six decades.
    curve = next(s for s in bode.panels[0].series if s.kind == "line")
    assert curve.x[0] < phase.omega < gain.omega < curve.x[-1]
    assert curve.x[-1] < 6 * gain.omega


def test_a_loop_that_is_only_measured_has_the_same_figures(fit):
    model = gb.margins(fit, RateLoop())
    omega = np.geomspace(2, 80, 40)
    gain = model.require_loop().broken_at("u", omega)[0]
    variance = 2e-4 * np.abs(gain) ** 2
    measured = gb.FrequencyResponse(omega, gain, "u", "u", variance=variance)
    answer = gb.margins(measured)
    bode, nichols, nyquist = loop_figures(answer)
    points = next(s for s in bode.panels[0].series if s.name == "measured")
    np.testing.assert_allclose(points.y, 20 * np.log10(np.abs(gain[np.isin(omega, points.x)])))
    (mark,) = (
        s for s in nichols.panels[0].series if s.is_across and s.low is not None and s.color == 1
    )
    assert mark.low[0] == pytest.approx(answer["phase margin"].low - 180)
    assert any(s.name.startswith("modulus margin") for s in nyquist.panels[0].series)
    assert gb.plotting.loop(answer).size == 4


def test_measured_points_lie_on_the_loop_in_the_turn_of_the_critical_point(fit):
    answer = gb.margins(fit, RateLoop())
    omega = np.geomspace(3, 40, 12)
    gain = answer.require_loop().broken_at("u", omega)[0]
    variance = 2e-4 * np.abs(gain) ** 2
    measured = gb.FrequencyResponse(omega, gain, "u", "u", variance=variance, name="injected")
    bode, nichols, nyquist, *_ = loop_figures(replace(answer, points=(measured,)))
    for panel in bode.panels:
        curve = next(s for s in panel.series if s.kind == "line")
        points = next(s for s in panel.series if s.name == "injected")
        np.testing.assert_allclose(np.interp(omega, curve.x, curve.y), points.y, atol=0.02)
        unit = 20 / np.log(10) if "dB" in panel.label else np.degrees(1)
        np.testing.assert_allclose(points.high - points.low, 2 * 0.01 * unit, rtol=1e-3)
    points = next(s for s in nichols.panels[0].series if s.name == "injected")
    assert np.all((points.x > -360) & (points.x <= 0))
    points = next(s for s in nyquist.panels[0].series if s.name == "injected")
    np.testing.assert_allclose(points.x + 1j * points.y, gain)
    # The region of a complex number with a known variance: twice that has two degrees of freedom.
    radius = np.sqrt(variance / 2 * stats.chi2.ppf(0.95, 2))
    np.testing.assert_allclose(points.high - points.y, radius)
    np.testing.assert_allclose(points.y - points.low, radius)


def test_allowed_gains_todays_and_the_proposed_ones_are_drawn(fit):
    safe = gb.safe_gains(fit, RateLoop(), {"K_P": (0.01, 0.5)})
    names = [series.name for series in gains_figure(safe).panels[0].series]
    assert "today" in names
    assert "proposed" not in names  # the best other one is refused
    assert safe.comparison
    as_good = replace(safe.comparison, refusals=())
    safe = replace(safe, comparison=as_good)
    confidence, _, today, best = gains_figure(safe).panels[0].series
    assert np.array_equal(confidence.y, safe.confidence, equal_nan=True)
    assert (today.x[0], best.x[0]) == (0.05, safe.best["K_P"])
    assert gb.plotting.gains(safe).size == 4
    # A second gain from zero, of which all values are as good.
    two, today = safe.values | {"K_D": np.linspace(0, 1, 3)}, safe.today | {"K_D": 0.5}
    both = replace(as_good, gains=safe.best | {"K_D": 0.0})
    tables = {name: np.stack([getattr(safe, name)] * 3, 1) for name in ("confidence", "objective")}
    figure = gains_figure(replace(safe, values=two, today=today, comparison=both, **tables))
    refused, allowed, *marks = figure.panels[0].series
    assert allowed.x.size == 3 * safe.allowed.sum() == 3 * safe.allowed.size - refused.x.size
    assert [mark.y[0] for mark in marks] == [0.5, 0.0]
    assert (figure.is_logarithmic, figure.panels[0].is_logarithmic) == (True, False)


def test_both_loops_are_drawn_as_their_numbers_say(fit):
    comparison = gb.safe_gains(fit, RateLoop(), {"K_P": (0.01, 0.5)}).comparison
    safe = gb.safe_gains(fit, RateLoop(), {"K_P": (0.01, 0.5)})
    sensitivity, step, moment = comparison_figures(safe)
    for name, place in (("today", "today"), ("refused", "changed")):
        label = {"today": "with today's gains", "refused": "with the refused gains"}[name]
        curves = []
        for figure in (sensitivity, step, moment):
            curves += [s for s in figure.panels[0].series if s.name == label]
        size, stepped, moved = curves
        change = comparison["peak |S|"]
        assert size.y.max() == pytest.approx(getattr(change, place), abs=0.02)
        overshoot = getattr(comparison["overshoot of p"], place)
        assert 100 * (stepped.y.max() - 1) == pytest.approx(max(overshoot, 0), abs=0.5)
        peak = getattr(comparison["peak of p from a moment at u"], place)
        assert np.abs(moved.y).max() == pytest.approx(peak, rel=0.02)


def test_a_page_has_the_table_and_the_figures_of_both_loops(fit, tmp_path):
    safe = gb.safe_gains(fit, RateLoop(), {"K_P": (0.01, 0.5)})
    gb.report(fit, tmp_path / "page.html", gains=safe, margins=gb.margins(fit, RateLoop()))
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    section = text[text.index("<h2>Gains</h2>") :]
    assert "Keep today's gains" in section
    for change in safe.comparison.changes:
        assert f"<td>{change.name}</td>" in section.replace(' class="prose"', "")
    assert section.count('class="plot"') == 4
    # Margins are a table with figures, not the text of a terminal.
    section = text[text.index("<h2>Stability margins</h2>") : text.index("<h2>Gains</h2>")]
    assert "<pre" not in section
    assert "<td>phase margin</td>" in section
    with pytest.raises(TypeError, match=r"what gb\.safe_gains returns"):
        gb.report(fit, tmp_path / "page.html", gains=3)
