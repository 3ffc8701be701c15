"""Card logs of a Crazyflie: the numbers that were written, and what damage costs."""

import struct

import numpy as np
import pytest
from synthetic_logs import crazyflie

from greybox.data.logs.readers import read


@pytest.fixture
def saved(tmp_path):
    def write_and_read(data, **options):
        path = tmp_path / "log00"
        path.write_bytes(data)
        return read(path, **options)

    return write_and_read


@pytest.mark.parametrize("version", [1, 2])
def test_every_event_is_a_record(saved, version):
    log = saved(crazyflie(version))
    assert list(log) == ["fixedFrequency", "estTDOA"]
    regular, distances = log["fixedFrequency"], log["estTDOA"]
    k = np.arange(300)
    np.testing.assert_allclose(regular.time, 5 + k / 100)
    np.testing.assert_array_equal(regular["gyro.x"], np.sin(0.1 * k).astype("f4"))
    np.testing.assert_array_equal(regular["motor.m1"], 100 * k)
    assert regular.units == {"gyro.x": "deg/s", "motor.m1": ""}
    np.testing.assert_array_equal(distances["idA"], k[::3] % 256)
    np.testing.assert_array_equal(distances["distanceDiff"], 0.5 * k[::3])
    assert log.findings == ()


def test_events_that_are_asked_for_are_read_alone(saved):
    log = saved(crazyflie(), messages=("estTDOA", "estPose"))
    assert list(log) == ["estTDOA"]
    assert log.findings == ("there is no event estPose.",)


def test_a_log_that_was_cut_off_is_read_up_to_there(saved):
    whole = saved(crazyflie())["fixedFrequency"]
    log = saved(crazyflie()[:3001])
    record = log["fixedFrequency"]
    assert 100 < len(record) < 300
    np.testing.assert_array_equal(record["motor.m1"], whole["motor.m1"][: len(record)])
    assert any("its checksum is wrong" in text for text in log.findings)


def test_an_unknown_event_ends_the_log(saved):
    data = bytearray(crazyflie())
    third = data.index(struct.pack("<HQ", 65535, 5_020_000))
    data[third : third + 2] = b"\x07\x07"
    log = saved(bytes(data))
    np.testing.assert_array_equal(log["fixedFrequency"]["motor.m1"], [0, 100])
    assert any("bytes are damaged or cut off and were left out" in t for t in log.findings)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b"motor.m1(I)", b"motor.m1(s)", "no type for the variable"),
        (b"motor.m1(I)", b"motor.m1 I ", "no type for the variable"),
        (b"estTDOA\0", b"estTDOAx", "not a text"),
        (struct.pack("<H", 3) + b"estTDOA", struct.pack("<H", 65535) + b"estTDOA", "twice"),
    ],
)
def test_a_damaged_header_is_refused(saved, old, new, reason):
    with pytest.raises(ValueError, match=rf"damaged in its header \(.*({reason})"):
        saved(crazyflie().replace(old, new))
