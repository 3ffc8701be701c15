"""Batches of raw IMU samples, written by the definition of ISBH and ISBD, and the vibration in them."""

import json

import numpy as np
import pytest
from command_line import run
from synthetic_logs import BATCH, BATCH_RATE, Log, imu_batches

from greybox.logs.readers import read
from greybox.logs.readers.imu_batches import with_batches
from greybox.logs.readers.messages import Messages
from greybox.spectral.vibration import vibration


@pytest.fixture
def saved(tmp_path):
    def write(made):
        path = tmp_path / "log.bin"
        path.write_bytes(made.binary)
        return path

    return write


def test_batches_are_samples_in_time(saved):
    recording = read(saved(imu_batches()))
    assert {"ISBD[gyro0]", "ISBD[accel0]"} <= set(recording)
    assert not [text for text in recording.findings if "left out" in text]
    gyro = recording["ISBD[gyro0]"]
    assert (len(gyro), len(gyro.pieces), gyro.units["x"]) == (2 * BATCH, 2, "rad/s")
    assert gyro.rate == pytest.approx(BATCH_RATE)
    expected = 0.2 * np.sin(2 * np.pi * 87 * gyro.time)
    assert np.sqrt(np.mean((gyro["x"] - expected) ** 2)) == pytest.approx(0.005, rel=0.1)
    assert set(read(saved(imu_batches()), messages=("ISBD",))) == {"ISBD[gyro0]", "ISBD[accel0]"}


def test_lost_messages_leave_gaps_and_samples_in_their_places(saved):
    gyro = read(saved(imu_batches(sequence=[0, 1, 2, 9, 10])))["ISBD[gyro0]"]
    assert len(gyro) == 2 * 5 * 32
    expected = 0.2 * np.sin(2 * np.pi * 87 * gyro.time)
    assert np.sqrt(np.mean((gyro["x"] - expected) ** 2)) < 0.01


def test_batches_without_their_header_are_left_out(saved):
    made = (
        Log().fmt("ISBD", "QHHaaa", "TimeUS,N,seqno,x,y,z").fmt("ATT", "Qcc", "TimeUS,Roll,Pitch")
    )
    made.add("ISBD", 10_000_000, 0, 0, *[bytes(64)] * 3).add("ATT", 10_000_000, 0.0, 0.0)
    made.add("ATT", 10_100_000, 0.0, 0.0)
    recording = read(saved(made))
    assert list(recording) == ["ATT"]
    assert any("no ISBH that describes them" in text for text in recording.findings)


def test_batches_of_no_rate_no_divisor_and_no_samples_are_counted(saved):
    made = imu_batches()
    for number, divisor, rate, samples in (
        (97, 900, 0.0, 1),
        (98, 0, BATCH_RATE, 1),
        (99, 900, BATCH_RATE, 0),
    ):
        at = 20_000_000 + 1000 * number
        made.add("ISBH", at, number, 1, 0, divisor, BATCH, at, rate)
        for k in range(samples):
            made.add("ISBD", at + 1, number, k, *[bytes(64)] * 3)
    recording = read(saved(made))
    assert (
        "ISBD: 3 batches have no sound ISBH or no samples and were left out." in recording.findings
    )
    assert len(recording["ISBD[gyro0]"]) == 2 * BATCH


def test_vibration_is_found_and_inspected(saved, capsys):
    path = saved(imu_batches())
    x, y, z = vibration("ISBD[gyro0]", read(path)["ISBD[gyro0]"])
    assert x.peaks == pytest.approx((87,), abs=4)
    assert y.peaks == pytest.approx((87, 174), abs=4)
    assert z.peaks == ()
    assert x.rms == pytest.approx(0.2 / np.sqrt(2), rel=0.03)
    status, out, _ = run(capsys, "inspect", path, "--json")
    assert status == 0
    assert [one["signal"] for one in json.loads(out)["vibration"]] == ["x", "y", "z"] * 2


@pytest.mark.parametrize(
    ("before", "own"), [(0.0, True), (9.9, True), (10.1, False), (-0.1, False)]
)
def test_a_batch_begins_at_its_own_stamp_unless_that_is_of_another_clock(before, own):
    """One that is ten seconds older than its header, or younger: the header tells then."""
    sent = 50.0
    stamp = (sent - before) * 1e6
    known = {
        "N": 3.0,
        "type": 1.0,
        "instance": 2.0,
        "mul": 10.0,
        "smp_rate": 100.0,
        "SampleUS": stamp,
    }
    columns = {name: [value] for name, value in known.items()}
    header = Messages(
        "ISBH", np.array([0]), np.array([sent]), {k: np.array(v) for k, v in columns.items()}
    )
    rows = {"N": [3.0, 3.0, 4.0], "seqno": [0.0, 1.0, 0.0]}
    rows |= {
        f"{axis}[{k}]": np.array([k, 32.0 + k, 99.0]) * (1 + "xyz".index(axis))
        for axis in "xyz"
        for k in range(32)
    }
    data = Messages("ISBD", np.array([1, 2, 3]), None, {k: np.array(v) for k, v in rows.items()})
    (kept, made), findings = with_batches([header, data])
    assert (kept, findings) == (header, ())
    assert made.time == pytest.approx((sent - before if own else sent) + np.arange(64) / 100)
    assert made.columns["y"] == pytest.approx(2 * np.arange(64) / 10)
    assert made.units == dict.fromkeys("xyz", "rad/s")
    assert made.texts == {"sensor": ["gyro2"] * 64}
    assert made.order.tolist() == [1] * 32 + [2] * 32
