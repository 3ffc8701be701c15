"""Spectra of vibration are drawn over one range, with their peaks."""

import numpy as np
import pytest
from drawn_lines import legend

import greybox as gb
from greybox.data.record import Recording
from greybox.plotting.vibration import vibration

TIME = np.arange(6000) / 1000
UNITS = {"GyrX": "rad/s", "GyrY": "rad/s", "AccX": "m/s²"}


def log(rate=1000.0, size=6000):
    """Noise with a line of 80 Hz in the second signal and one of 30 Hz in the third."""
    random = np.random.default_rng(0)
    time = np.arange(size) / rate
    noise = random.normal(size=(3, size))
    lines = np.array(
        [0 * time, 2 * np.sin(2 * np.pi * 80 * time), 3 * np.sin(2 * np.pi * 30 * time)]
    )
    return gb.Record(time, dict(zip(UNITS, noise + lines, strict=True)), UNITS, name="IMU")


def test_a_panel_for_each_unit_with_the_density_of_its_signals_and_their_peaks():
    gyro, acceleration = vibration(Recording({"ISBD[gyro0]": log()}))
    assert [len(ax.get_lines()) for ax in (gyro, acceleration)] == [2, 1]
    plain, shaken = gyro.get_lines()
    assert [line.get_label() for line in (plain, shaken)] == ["GyrX", "GyrY"]
    hz, density = plain.get_data()
    assert hz[0] > 0
    assert np.median(density) == pytest.approx(
        np.sqrt(2 / 1000), rel=0.1
    )  # white of size one: 2 / rate per Hz
    (peak,) = gyro.texts
    at = float(peak.get_text())
    assert at == pytest.approx(80, abs=1.5)
    assert peak.xy == pytest.approx((at, shaken.get_ydata().max()), rel=1e-3)
    assert peak.get_color() == shaken.get_color() != plain.get_color()
    assert [float(text.get_text()) for text in acceleration.texts] == [pytest.approx(30, abs=1.5)]
    assert (gyro.get_ylabel(), acceleration.get_ylabel()) == (
        "ISBD[gyro0], rad/s / √Hz",
        "ISBD[gyro0], m/s² / √Hz",
    )
    (shaded,) = gyro.patches
    box = shaded.get_extents().transformed(gyro.transData.inverted())
    assert (box.x0, box.x1) == pytest.approx((0, 10))
    assert legend(gyro) == ["GyrX", "GyrY", "AccX"]


def test_panels_share_the_range_of_the_fastest_and_a_page_has_eight_at_most():
    two = vibration(Recording({"ISBD[gyro0]": log(), "IMU[0]": log(400.0)}), legend=False)
    assert [ax.get_xlim() for ax in two] == [(0, pytest.approx(500))] * 4
    assert two[0].figure.legends == []
    many = vibration(Recording({f"ISBD[gyro{k}]": log(size=600) for k in range(5)}))
    assert len(many) == 8
    heights = [ax.figure.get_size_inches()[1] for ax in (two[0], many[0])]
    assert 1.5 < heights[1] / heights[0] < 2
    with pytest.raises(
        ValueError,
        match="the recording has no gyro or accelerometer at 100 Hz or more: log raw bat",
    ):
        vibration(Recording({"IMU[0]": log(90.0)}))
