"""What the figures hold is what was measured and what the fitted model gives."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from page_results import lag

import greybox as gb
from greybox.html_report.figure import Figure, Panel, Series, figure_grid
from greybox.html_report.history_figures import history_figure
from greybox.html_report.interval_section import profile_figures
from greybox.html_report.residual_figures import residual_figures
from greybox.html_report.response_figures import _spread, response_figures
from greybox.html_report.sensitivity_figure import information_figure, sensitivity_figure
from greybox.html_report.spectrum_figures import spectrum_figure
from greybox.html_report.starts_figure import _limits, starts_figure
from greybox.models.polynomial import Polynomial
from greybox.solve.outcome import SCREENED


@pytest.fixture(scope="module")
def fit():
    return lag()


def named(panel, name, kind):
    (found,) = [s for s in panel.series if s.name.startswith(name) and s.kind == kind]
    return found


def test_the_bode_diagram_has_data_curve_band_and_errors(fit):
    bode, nyquist = response_figures([fit])
    part = fit.responses[0]
    labels = [panel.label.partition(",")[0] for panel in bode.panels]
    assert labels == ["Magnitude of y/u", "Phase of y/u", "Coherence γ²", "Error", "Error"]
    magnitude, phase, coherence, error, turn = bode.panels
    measured = named(magnitude, "lag", "points")
    assert measured.y == pytest.approx(20 * np.log10(np.abs(part.data.response)))
    for panel in bode.panels[:4]:
        assert named(panel, "lag", "points").x.tolist() == part.data.omega.tolist()
    one_sided = np.abs(part.data.response) + np.sqrt(part.data.variance / 2)
    assert measured.high == pytest.approx(20 * np.log10(one_sided))
    assert named(phase, "lag", "points").y == pytest.approx(
        np.degrees(np.angle(part.data.response))
    )
    assert named(coherence, "lag", "points").y == pytest.approx(part.data.coherence)
    ratio = part.data.response / part.response
    size = np.sqrt(part.data.variance / 2) / np.abs(
        part.data.response
    )  # of one component, relative
    left = named(error, "lag", "points")
    assert left.y == pytest.approx(20 * np.log10(np.abs(ratio)))
    assert [left.y - left.low, left.high - left.y] == [
        pytest.approx(-20 * np.log10(1 - size)),
        pytest.approx(20 * np.log10(1 + size)),
    ]
    turned = named(turn, "lag", "points")
    assert turned.y == pytest.approx(np.degrees(np.angle(ratio)))
    assert [turned.y - turned.low, turned.high - turned.y] == [pytest.approx(np.degrees(size))] * 2

    band = fit.response_band(part.data.omega, part=0)
    low, high = (20 * np.log10(limit) for limit in band.magnitude)
    drawn = named(magnitude, "fit of", "band")
    assert np.interp(np.log(band.omega), np.log(drawn.x), drawn.low) == pytest.approx(low, abs=1e-3)
    assert np.interp(np.log(band.omega), np.log(drawn.x), drawn.high) == pytest.approx(
        high, abs=1e-3
    )
    assert bode.is_logarithmic
    assert bode.caption == (
        "Shaded is the 95 % confidence band of the fitted response. Bars are one standard deviation of the "
        "measurement. Errors are measured less fitted values."
    )
    points = nyquist.panels[0].series[-1]
    assert points.x + 1j * points.y == pytest.approx(part.data.response)
    assert points.notes[0].endswith("at 1 rad/s")
    real, sign, imaginary = points.notes[3].split()[:3]
    assert sign == "−"
    assert float(real) - 1j * float(imaginary) == pytest.approx(part.data.response[3], rel=1e-3)
    curve = named(nyquist.panels[0], "fit of", "line")
    assert curve.x + 1j * curve.y == pytest.approx(
        fit.response(fit_omega(fit, curve)).response, rel=1e-6
    )
    assert (nyquist.limits, nyquist.is_plane) == (None, True)


def fit_omega(fit, curve):
    """The frequencies of a lag's points, from the ratio of its parts."""
    return -fit.estimate["a0"] * curve.y / curve.x


def test_data_stay_readable_beside_a_curve_that_is_far_off(fit):
    far = replace(
        fit.responses[0],
        curve=replace(fit.responses[0].curve, response=1e3 * fit.responses[0].curve.response),
    )
    _, nyquist = response_figures([replace(fit, parts=(far, fit.parts[1]), models=None)])
    data = fit.responses[0].data.response
    half = np.abs(data).max() / 2
    assert nyquist.limits == pytest.approx((-half, data.real.max() + half))
    assert nyquist.panels[0].limits == pytest.approx((data.imag.min() - half, half))
    assert nyquist.caption.startswith("Curves reach a magnitude of ")


def test_sensitivities_are_differences_of_fits_that_differ_by_a_percent(fit):
    figure = sensitivity_figure(fit, fit.responses[0], fit.models[0])
    for k, name in enumerate(fit.free):
        magnitude, phase = (panel.series[k] for panel in figure.panels)
        assert magnitude.name == name
        step = 1e-4
        moved = tuple(
            replace(q, value=q.value * (1 + step)) if q.name == name else q for q in fit.quantities
        )
        change = (
            replace(fit, quantities=moved).response(magnitude.x).response
            / fit.response(magnitude.x).response
        )
        assert magnitude.y == pytest.approx(
            20 * np.log10(np.abs(change)) * 0.01 / step, rel=1e-3, abs=1e-6
        )
        assert phase.y == pytest.approx(
            np.degrees(np.angle(change)) * 0.01 / step, rel=1e-3, abs=1e-6
        )


def test_what_is_zero_has_no_sensitivity(fit):
    """One percent does not move it."""
    at_zero = replace(
        fit,
        quantities=tuple(replace(q, value=0.0) if q.name == "a0" else q for q in fit.quantities),
    )
    shown = sensitivity_figure(at_zero, fit.responses[0], fit.models[0])
    assert [series.name for series in shown.panels[0].series] == [
        name for name in fit.free if name != "a0"
    ]


def test_histories_show_degrees_and_extremes_of_what_is_too_long(fit):
    output, residual, given = history_figure([fit], 0, ["fit"], 2000).panels
    part = fit.records[0]
    assert output.label == "y, °"
    assert named(output, "measured", "points").y == pytest.approx(np.degrees(part.data["y"]))
    assert named(residual, "fit", "line").y == pytest.approx(np.degrees(part.residual("y")))
    assert given.series[0].y == pytest.approx(part.data["u"])
    zero = named(residual, "", "rule")
    assert (zero.x.tolist(), zero.y.tolist()) == ([0], [0])
    whole = history_figure([fit], 0, ["fit"], 100)
    assert "smallest and largest" not in (whole.caption or "")
    assert "smallest and largest of each 3" in history_figure([fit], 0, ["fit"], 99).caption
    thinned = history_figure([fit], 0, ["fit"], 10)
    line = named(thinned.panels[0], "fit", "line")
    assert len(line.x) < 40
    assert line.y.max() == pytest.approx(np.degrees(part.simulated["y"].max()))
    assert "smallest and largest of each 20" in thinned.caption


def test_residuals_are_correlated_as_numpy_says(fit):
    (figure,) = residual_figures(fit.records[0])
    e = fit.records[0].residual("y")
    e = e[np.isfinite(e)] - np.nanmean(e)
    expected = [float(e[k:] @ e[:-k] / (e @ e)) for k in range(1, 6)]
    assert named(figure.panels[0], "", "points").y[:5] == pytest.approx(expected, abs=0.02)


def test_starts_are_sorted_and_failed_ones_stand_at_the_right(fit):
    first, second, third = fit.runs
    runs = (first, replace(second, converged=False, status="restoration failed"), third)
    minima = (replace(fit.minima[0], runs=(first.index, third.index)),)
    figure = starts_figure(replace(fit, runs=runs, minima=minima))
    minimum, failed = figure.panels[0].series
    assert minimum.x.tolist() == [1, 2]
    assert failed.x.tolist() == [3]
    assert failed.notes == ["start 1, restoration failed"]
    assert minimum.y.tolist() == sorted(run.cost for run in (first, third))
    low, high = figure.panels[0].limits
    assert low < failed.y[0] < high
    assert [figure.panels[0].label, figure.label, figure.limits] == [
        "Cost",
        "Runs, sorted by cost",
        (0.0, 4.0),
    ]
    assert figure.caption == (
        "2 of 3 starts agree on the best minimum. Failed runs stand at the right; their height means nothing."
    )
    none = replace(fit, runs=tuple(replace(run, converged=False) for run in fit.runs), minima=())
    assert starts_figure(none).caption.startswith("None of 3 starts converged.")


def test_the_spectrum_of_a_manoeuvre_has_data_fit_and_what_is_left(fit):
    time = 0.05 * np.arange(201)
    u = np.exp(-((time - 2) ** 2))
    y = gb.simulate(Polynomial(1, 0), fit.estimate, gb.Record(time, {"u": u}))["y"]
    spectrum = gb.spectral.transient_spectrum(
        gb.Record(time, {"u": u, "y": y}, {"y": "rad"}), "u", "y", (0.5, 6)
    )
    fitted = gb.fit(gb.Problem(Polynomial(1, 0), spectrum), starts=2, progress=False)
    output, given = spectrum_figure(fitted.spectra[0]).panels
    assert named(output, "measured", "points").y == pytest.approx(
        np.degrees(np.abs(spectrum.outputs["y"]))
    )
    assert named(output, "fit of", "line").y == pytest.approx(
        np.degrees(np.abs(spectrum.outputs["y"])), rel=0.01, abs=0.01
    )
    assert given.series[0].y == pytest.approx(np.abs(spectrum.inputs["u"]))
    assert [output.label, given.label] == ["y, (°) s", "u, s"]
    assert [output.is_logarithmic, given.is_logarithmic] == [True, True]
    left = named(output, "what is left", "points").y
    assert left == pytest.approx(np.degrees(np.abs(fitted.spectra[0].residual("y"))))


def test_numbers_keep_the_digits_that_zooming_needs():
    clock = 1.7e9 + 0.01 * np.arange(5)
    plain = Series("a", "line", clock, np.array([1 / 3, np.nan, np.inf, 2.0, 1e-9])).plain
    assert np.diff(plain["x"]) == pytest.approx(np.full(4, 0.01), rel=1e-3)
    assert plain["y"] == [0.33333, None, None, 2, 1e-9]


@pytest.mark.parametrize(
    ("costs", "is_logarithmic", "limits"),
    [
        ([], False, (0.0, 1.0)),
        ([2.0, 3.0, 300.0], True, (2 / 1.5, 450.0)),
        (
            [-5.0, -4.9],
            False,
            (-5.5, -3.9),
        ),  # rounding is no range: a tenth of the cost below, and two above
        ([1.0, 21.0], False, (-1.0, 25.0)),
    ],
)
def test_the_axis_of_costs_shows_neither_rounding_nor_one_point(costs, is_logarithmic, limits):
    assert _limits(costs, is_logarithmic) == pytest.approx(limits)


def test_what_tells_of_parameters_is_drawn_in_percent_of_all(fit):
    figure = information_figure(fit, 0)
    along, alone = figure.panels
    found = fit.sensitivity(0)
    for panel, shares in ((along, found.shares), (alone, found.alone)):
        for k, name in enumerate(found.names):
            assert named(panel, name, "line").y == pytest.approx(100 * shares[k].sum(axis=0))
    assert figure.label == "ω, rad/s"
    assert figure.is_logarithmic
    assert not figure.is_wide


def test_profiles_are_drawn_beside_the_cone_of_the_standard_error():
    values, roots = np.array([0.7, 1.0, 1.4]), np.array([-2.5, 0.0, 2.6])
    given = {
        "interval": (0.8, np.inf),
        "estimate": 1.0,
        "bias": 0.1,
        "standard_error": 0.15,
        "unit": "s",
    }
    profile = SimpleNamespace(name="T", values=values, roots=roots, **given)
    (figure,) = profile_figures(SimpleNamespace(profiles=[profile], limit={"T": 2.0}))
    (panel,) = figure.panels
    assert named(panel, "profile", "line").y == pytest.approx([2.5, 0.0, 2.6])
    cone = named(panel, "by the standard error", "line")
    assert (cone.x, cone.y) == (
        pytest.approx([1 - 0.15 * 3.2, 1, 1 + 0.15 * 3.2]),
        pytest.approx([3.2, 0, 3.2]),
    )
    assert named(panel, "limit", "line").y == pytest.approx([2.1, 2.1, 1.9, 1.9])
    assert named(panel, "interval", "band").x == pytest.approx(
        [0.8, 1.4]
    )  # open above: to the end of the curve
    assert (figure.limits, panel.limits, figure.label) == ((0.7, 1.4), (0.0, 3.2), "T, s")


@pytest.mark.parametrize(
    ("least", "cost", "is_logarithmic"),
    [
        (1.0, 2.0, False),
        (1.0, 500.0, True),
        (0.0, 500.0, False),
        (10.0, 90.0, False),
        (0.01, 0.9, True),
    ],
)
def test_costs_that_span_decades_have_a_logarithmic_axis(fit, least, cost, is_logarithmic):
    first, second, *_ = fit.runs
    runs = (replace(first, cost=least, converged=True), replace(second, cost=cost, converged=True))
    minima = tuple(replace(fit.minima[0], cost=run.cost, runs=(run.index,)) for run in runs)
    (panel,) = starts_figure(replace(fit, runs=runs, minima=minima)).panels
    assert panel.is_logarithmic is is_logarithmic
    assert [series.name for series in panel.series] == [
        f"minimum {k}: 1 × cost {c:g}" for k, c in ((1, least), (2, cost))
    ]


def test_wide_figures_and_a_figure_alone_take_the_whole_width():
    usual, wide = Figure("a", "x", []), Figure("b", "x", [], is_wide=True)
    assert [element.get("class") for element in figure_grid([usual, wide])] == [None, "wide"]
    assert [element.get("class") for element in figure_grid([usual])] == ["wide"]


def test_limits_of_axes_are_handed_on_where_there_are_any():
    assert Panel("a", [], limits=(0.5, np.inf)).plain["limits"] == [0.5, None]
    assert Panel("a", [], limits=(0.0, 123456.7)).plain["limits"] == [
        0,
        123460,
    ]  # five digits of what has no span
    usual = Panel("a", []).plain
    assert (usual["limits"], usual["log"], usual["height"]) == (None, False, 1.0)
    for limits, plain in (((0.0, 3.0), [0, 3]), (None, None)):
        plot = Figure("a", "x", [], limits=limits).element.find("div")
        assert json.loads(plot.get("data-figure"))["limits"] == plain


@pytest.mark.parametrize("count", [1, 2, 400, 401, 5000])
def test_curves_have_no_more_points_than_can_be_seen_and_keep_their_ends(count):
    rows = _spread(count)
    assert (rows[0], rows[-1], rows.size) == (0, count - 1, min(count, 400))
    assert np.diff(rows).max(initial=1) <= -(-count // 399)


def test_minima_have_five_colors_and_further_ones_and_failed_runs_none(fit):
    first = fit.runs[0]
    ended = [
        replace(first, index=k, cost=3.0 + k, iterations=k + 1, converged=True) for k in range(7)
    ]
    lost = [replace(first, index=7 + k, status="stagnated", converged=False) for k in range(2)]
    screened = [replace(first, index=9 + k, stage=SCREENED) for k in range(4)]
    minima = tuple(replace(fit.minima[0], cost=run.cost, runs=(run.index,)) for run in ended[:6])
    minima = (
        replace(minima[0], runs=(6, 0)),
        *minima[1:],
    )  # the dearest run counts to the first as well
    made = replace(fit, runs=(*reversed(ended), *lost, *screened), minima=minima)
    figure = starts_figure(made)
    *found, failed = figure.panels[0].series
    assert [series.name for series in found] == [
        "minimum 1: 2 × cost 3",
        *(f"minimum {k}: 1 × cost {2 + k}" for k in range(2, 6)),
        "further minima",
    ]
    assert [series.x.tolist() for series in found] == [[1, 7], [2], [3], [4], [5], [6]]
    assert [series.y.tolist() for series in found] == [[3, 9], [4], [5], [6], [7], [8]]
    assert [(series.color, series.style) for series in found] == [
        (0, 0),
        (1, 1),
        (2, 2),
        (3, 3),
        (4, 4),
        (-1, 0),
    ]
    assert found[0].notes == ["start 0, cost 3, 1 iteration", "start 6, cost 9, 7 iterations"]
    assert (failed.name, failed.color, failed.x.tolist()) == ("2 × failed", -2, [8, 9])
    assert failed.style not in range(5)
    assert (figure.limits, figure.is_whole) == ((0.0, 10.0), True)
    said = f"{made.agreeing} of 9 most promising of 13 starts agree on the best minimum. Failed runs stand at the right"
    assert made.agreeing > 1
    assert figure.caption.startswith(said)
    alone = starts_figure(replace(fit, runs=(ended[0],), minima=(replace(minima[0], runs=(0,)),)))
    assert alone.caption == "1 of 1 start agrees on the best minimum."


@pytest.mark.parametrize("dearest", [6.0, 4e5])
def test_failed_runs_stand_below_the_upper_end_of_their_axis(fit, dearest):
    runs = [replace(fit.runs[0], index=0, cost=3.0), replace(fit.runs[0], index=1, cost=dearest)]
    runs.append(replace(fit.runs[0], index=2, converged=False))
    minima = tuple(replace(fit.minima[0], cost=run.cost, runs=(run.index,)) for run in runs[:2])
    (panel,) = starts_figure(replace(fit, runs=tuple(runs), minima=minima)).panels
    above, top = panel.limits[1], panel.series[-1].y
    assert panel.is_logarithmic is (dearest > 100)
    assert dearest < top[0] < above


def test_bounds_of_correlations_are_drawn_about_zero(fit):
    (figure,) = residual_figures(fit.records[0])
    panel = figure.panels[0]
    band = named(panel, "99 % bound", "band")
    bound = 2.576 / np.sqrt(np.isfinite(fit.records[0].residual("y")).sum())
    assert band.high == pytest.approx(np.full(band.x.size, bound), rel=0.02)
    assert band.low.tolist() == band.y.tolist() == (-band.high).tolist()
    points = named(panel, "", "points")
    assert [points.low.tolist(), points.high.tolist()] == [
        [min(r, 0.0) for r in points.y],
        [max(r, 0.0) for r in points.y],
    ]
    assert points.x.tolist() == band.x.tolist() == [*range(1, points.y.size + 1)]
    most = max(np.abs(points.y).max(), bound)
    assert most < panel.limits[1] == -panel.limits[0] < 1.5 * most
    assert [panel.label, figure.label, figure.is_whole] == ["Autocorrelation", "Lag, samples", True]
    assert figure.caption.startswith(
        "99 % of single correlations stay within the band if there is none. Probability"
    )
    assert "with themselves p" in figure.caption
