"""Peaks of a spectrum of vibration, by what stands out of what is drawn."""

import numpy as np
import pytest

from greybox.data.record import Record
from greybox.spectral.vibration import (
    Vibration,
    peaks_of,
    power_density,
    sensors,
    vibration,
    vibration_table,
)

HZ = np.arange(0, 500.0)


def spectrum(*peaks):
    """A level of 0 dB, with peaks of so many dB at so many Hz."""
    level = np.zeros(500)
    for hz, height in peaks:
        level = np.maximum(level, height - 0.5 * np.abs(HZ - hz))
    return 10 ** (level / 10)


@pytest.mark.parametrize(("height", "found"), [(9.6, ()), (10.4, (120.0,))])
def test_a_peak_stands_out_by_ten_decibels(height, found):
    assert peaks_of(HZ, spectrum((120, height))) == found


def test_the_three_highest_peaks_come_the_highest_first():
    assert peaks_of(HZ, spectrum((60, 15), (150, 30), (240, 20), (350, 25))) == (
        150.0,
        350.0,
        240.0,
    )


def test_the_motion_of_the_vehicle_is_no_vibration():
    assert peaks_of(HZ, spectrum((6, 40), (120, 15))) == (120.0,)
    lines = np.ones(500)
    lines[[9, 12]] = 1000, 100
    assert peaks_of(HZ, lines) == (12.0,)


def test_the_size_of_vibration_is_that_above_the_motion():
    """Two stretches of a gyro at 1 kHz: sines of 0.3 at 50 Hz and of 0.1 at 125 Hz, beside a motion of 5 at 2 Hz."""
    time = np.concatenate([np.arange(4000) / 1000, 10 + np.arange(4000) / 1000])
    x = (
        5 * np.sin(4 * np.pi * time)
        + 0.3 * np.sin(100 * np.pi * time)
        + 0.1 * np.sin(250 * np.pi * time)
    )
    (found,) = vibration("ISBD[gyro0]", Record(time, {"x": x}, {"x": "rad/s"}))
    assert found.rms == pytest.approx(np.sqrt((0.3**2 + 0.1**2) / 2), rel=0.02)
    assert found.peaks == pytest.approx((50, 125), abs=2)
    assert (found.message, found.signal, found.unit) == ("ISBD[gyro0]", "x", "rad/s")
    assert found.rate == pytest.approx(1000)
    header, _, row = (line.split() for line in vibration_table([found]).splitlines())
    assert header == ["vibration", "Hz", "rms", "peaks,", "Hz"]
    peaks = [f"{found.peaks[0]:.4g},", f"{found.peaks[1]:.4g}"]
    assert row == ["ISBD[gyro0]", "x", "1000", f"{found.rms:.3g}", "rad/s", *peaks]
    assert vibration("IMU", Record(time[:20], {"x": x[:20]})) == []


def made(rate, count, signals, start=0.0):
    return Record(
        start + np.arange(count) / rate, {name: np.arange(float(count)) for name in signals}
    )


def test_sensors_are_raw_batches_and_fast_imu_messages():
    """From ten times 10 Hz, less a twentieth, and stretches of 64 samples on."""
    recording = {
        "ISBD[gyro0]": made(1000, 64, ["x", "y"]),
        "ISBD[gyro1]": made(1000, 63, ["x"]),
        "IMU[0]": made(96, 100, ["GyrX", "AccZ", "T"]),
        "IMU[1]": made(94, 100, ["GyrX"]),
        "IMU[2]": made(400, 100, ["T"]),
        "RATE": made(400, 100, ["GyrX"]),
        "IMU[3]": Record(np.arange(100.0) / 400, {"GyrX": np.arange(100.0)}, has_time=False),
    }
    found = sensors(recording)
    assert {name: list(record.signals) for name, record in found.items()} == {
        "ISBD[gyro0]": ["x", "y"],
        "IMU[0]": ["GyrX", "AccZ"],
    }


def test_the_density_is_the_mean_of_stretches_by_their_samples():
    """Of sines of two sizes in stretches of 960 and 240 samples, in windows of a sixth of the samples together."""
    rate, sizes = 1000.0, {960: 2.0, 240: 6.0}
    time = np.concatenate([np.arange(960) / rate, 3 + np.arange(240) / rate])
    x = np.concatenate(
        [a * np.sin(2 * np.pi * 100 * np.arange(n) / rate) for n, a in sizes.items()]
    )
    hz, (density,) = power_density(Record(time, {"x": x}))
    assert hz[1] == pytest.approx(rate / 200)
    near = np.abs(hz - 100) < 3 * hz[1]
    power = np.sum(density[near]) * hz[1]
    assert power == pytest.approx((960 * 2.0**2 / 2 + 240 * 6.0**2 / 2) / 1200, rel=1e-3)
    long = Record(np.arange(20000) / rate, {"x": np.sin(np.arange(20000.0))})
    assert power_density(long)[0][1] == pytest.approx(rate / 1024)


def test_a_table_has_four_digits_of_the_rate_and_the_peaks_and_three_of_the_size():
    found = [
        Vibration("IMU", "GyrX", 1234.567, 0.0123456, "rad/s", (123.456, 98.7654)),
        Vibration("ISBD[gyro0]", "x", 400.0, 2.0, "", ()),
    ]
    _, _, first, second = vibration_table(found).splitlines()
    assert first.split() == ["IMU", "GyrX", "1235", "0.0123", "rad/s", "123.5,", "98.77"]
    assert second.split() == ["ISBD[gyro0]", "x", "400", "2", "-"]
    # Names and peaks begin below one another, numbers end so.
    assert first.startswith("IMU ")
    assert first.index("GyrX") == second.index("x ")
    assert first.index("1235") + 4 == second.index("400") + 3
    assert first.index("123.5,") == second.index("-")
