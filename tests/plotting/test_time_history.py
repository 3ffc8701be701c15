"""Figures of fitted and predicted records show what they hold: lines, gaps, bands, windows."""

from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from declared_models import TWO_LAGS_OMEGA, Lag, measured
from drawn_lines import legend
from hardening_spring import Spring, driven

import greybox as gb
from greybox.plotting.time_history import _half_width

mpl.use("Agg")
WHOLE = driven(20.0, noise=0.05, seed=2)
GAPPED = WHOLE.rows(np.flatnonzero((WHOLE.time < 6) | (WHOLE.time > 7.5)))


@pytest.fixture(scope="module")
def fit():
    return gb.fit(gb.Problem(Spring(), GAPPED), starts=2, progress=False)


@pytest.fixture(scope="module")
def stiff():
    return gb.fit(gb.Problem(Spring(), GAPPED, fixed={"stiffness": 4.4}), starts=2, progress=False)


def line(axis, color):
    (found,) = [
        k
        for k in axis.lines
        if k.get_color() == color and k.get_linestyle() == "-" and len(k.get_xdata()) > 2
    ]
    return found.get_data()


def test_a_fit_is_drawn_over_what_was_measured_with_what_is_left_and_the_input(fit):
    axes = gb.plotting.time_history(fit)
    output, below, force = axes
    assert [axis.get_ylabel() for axis in axes] == ["position, m", "residual", "force"]
    assert output.get_title() == "spring"
    time, drawn = line(output, "#0072B2")
    there = np.isfinite(drawn)
    assert np.allclose(
        np.interp(time[there], GAPPED.time, fit.parts[0].simulated["position"]), drawn[there]
    )
    time, left = line(below, "#0072B2")
    assert np.sqrt(np.nanmean(left**2)) == pytest.approx(0.05, rel=0.1)
    time, drawn = line(force, "#222222")
    assert np.isclose(np.nanmax(drawn), GAPPED["force"].max())


def test_of_a_short_record_every_sample_is_a_dot():
    time = 0.1 * np.arange(40)
    record = gb.Record(
        time,
        {"force": np.sin(time), "position": np.where(time == 1.0, np.nan, 2 + np.cos(time))},
        {"position": "rad"},
    )
    short = gb.predict(Spring(), {}, record, horizon=1.0)
    output, below, force = gb.plotting.time_history(short)
    (dots,) = [k for k in output.lines if k.get_marker() == "." and k.get_color() == "#AAAAAA"]
    there = np.isfinite(record["position"])
    np.testing.assert_allclose(
        dots.get_xydata(), np.column_stack([time, np.degrees(record["position"])])[there]
    )
    at, left = line(below, "#0072B2")
    known = np.isfinite(left)
    expected = np.degrees(record["position"] - short.record["position"])
    np.testing.assert_allclose(
        left[known],
        np.interp(at[known], time[np.isfinite(expected)], expected[np.isfinite(expected)]),
    )
    output_band, left_band = output.collections[0], below.collections[0]
    half = np.nanmax(np.degrees(1.959964 * short.record["position_error"]))
    assert max(path.get_extents().y1 for path in left_band.get_paths()) == pytest.approx(
        half, rel=1e-3
    )
    assert min(path.get_extents().y0 for path in left_band.get_paths()) == pytest.approx(
        -half, rel=1e-3
    )
    assert output_band.get_paths()
    assert force.get_xlabel() == "Time, s"


def test_a_gap_is_left_open(fit):
    for axis, color in zip(
        gb.plotting.time_history(fit), ("#0072B2", "#0072B2", "#222222"), strict=True
    ):
        time, drawn = line(axis, color)
        kept = time[np.isfinite(time) & np.isfinite(drawn)]
        (gap,) = np.flatnonzero(np.diff(kept) > 1)
        place = np.flatnonzero(time == kept[gap])[0]
        assert np.isnan(time[place + 1 : np.flatnonzero(time == kept[gap + 1])[0]]).any()


def test_several_fits_are_laid_over_one_another(fit, stiff):
    axes = gb.plotting.time_history(fit, stiff, labels=("free", "stiff"))
    assert legend(axes[0]) == ["measured", "free", "stiff", "95 % band without noise"]
    left = [np.nanstd(line(axes[1], color)[1]) for color in ("#0072B2", "#D55E00")]
    assert left[1] > 1.5 * left[0]
    assert legend(gb.plotting.time_history(fit, stiff)[0])[1:3] == [
        "fit of Spring 1",
        "fit of Spring 2",
    ]


def test_predictions_begin_anew_in_every_window_and_have_a_band(fit):
    prediction = gb.predict(fit, record=WHOLE, horizon=2.0)
    output = gb.plotting.time_history(prediction)[0]
    _, drawn = line(output, "#0072B2")
    assert np.isnan(drawn).sum() == len(prediction) - 1 == 8
    (band,) = output.collections
    assert len(band.get_paths()) == 9
    assert max(path.get_extents().y1 for path in band.get_paths()) > np.nanmax(drawn)
    begins = [k for k in output.lines if k.get_marker() == "." and k.get_color() == "#0072B2"]
    assert begins[0].get_xdata().tolist() == WHOLE.time[prediction.rows[:, 0]].tolist()
    assert "95 % band without noise" in legend(output)


def test_angles_are_drawn_in_degrees():
    record = gb.Record(WHOLE.time, dict(WHOLE.signals), {"position": "rad"})
    output = gb.plotting.time_history(gb.predict(Spring(), {}, record, horizon=1.0))[0]
    assert output.get_ylabel() == "position, °"
    shown = np.nanmax(line(output, "#0072B2")[1])
    assert shown == pytest.approx(np.degrees(np.nanmax(WHOLE["position"])), rel=0.2)


def test_long_records_are_thinned_to_their_extremes():
    time = np.arange(60_000) / 50
    force = np.sin(time)
    force[31_234] = 9.0
    record = gb.Record(time, {"force": force, "position": np.zeros(time.size)})
    axis = gb.plotting.time_history(gb.predict(Spring(), {}, record, horizon=100.0, lead=1.0))[-1]
    shown = line(axis, "#222222")[1]
    assert shown.size < 6000
    assert np.nanmax(shown) == 9.0


def test_plot_shows_the_records_of_a_fit_and_its_responses(fit, tmp_path):
    figure = gb.plot(fit)
    assert [axis.get_ylabel() for axis in figure.axes] == [
        "position, m",
        "residual",
        "force",
        "Cost",
    ]
    figure.savefig(tmp_path / "a.png")
    response = gb.Problem(Spring(), measured(Spring(), np.geomspace(0.5, 8, 12), noise=0.02))
    both = gb.plot(gb.fit(gb.Problem(Spring(), GAPPED) + response, starts=2, progress=False))
    labels = [axis.get_ylabel() for axis in both.axes]
    assert labels[:4] == ["position, m", "residual", "force", "Cost"]
    assert labels[4].startswith("Magnitude")
    both.savefig(tmp_path / "b.png")


def test_wrong_use_is_said_in_a_sentence(fit):
    response = gb.fit(gb.Problem(Lag(), measured(Lag(), TWO_LAGS_OMEGA)), starts=3, progress=False)
    with pytest.raises(ValueError, match=r"has no record: draw its responses with gb\.plot"):
        gb.plotting.time_history(response)
    with pytest.raises(
        ValueError, match=r"no frequency response to draw: gb.plotting.time_history draws"
    ):
        gb.plotting.bode(fit)
    with pytest.raises(ValueError, match="there is nothing to draw"):
        gb.plotting.time_history()
    with pytest.raises(TypeError, match="give a Fit or a Prediction"):
        gb.plotting.time_history(WHOLE)
    with pytest.raises(ValueError, match="there is no record 1: the fit has 1"):
        gb.plotting.time_history(fit, record=1)
    with pytest.raises(ValueError, match="belong to different records"):
        gb.plotting.time_history(fit, gb.predict(fit, record=WHOLE))
    with pytest.raises(ValueError, match="there are 2 labels for 1 items"):
        gb.plotting.time_history(fit, labels=("a", "b"))


def test_bands_are_half_as_wide_on_either_side_and_straight_between_samples():
    part = SimpleNamespace(error=1, data=range(5))
    band = np.array([[1.0, np.nan, 3.0, 2.0, np.nan], [2.0, np.nan, 7.0, 2.5, np.nan]])
    unknown = np.full((2, 5), np.nan)
    fit = SimpleNamespace(
        known=1, parts=(part,), output_band=lambda part: {"y": band, "z": unknown}
    )
    (found,) = _half_width(fit, part).items()
    assert found[0] == "y"
    np.testing.assert_allclose(found[1], [0.5, 1.25, 2.0, 0.25, np.nan])
    assert _half_width(fit, SimpleNamespace(error=None)) == {}
