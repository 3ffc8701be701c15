"""Packets as pymavlink packs and unpacks them."""

import mmap
import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from greybox.logs.readers.telemetry_frames import KINDS, find_packets, layout, payloads

START = 1_700_000_000_000_000  # µs since 1970


@pytest.fixture
def mapped(tmp_path):
    def map_bytes(data):
        path = tmp_path / "flight.tlog"
        path.write_bytes(data)
        with path.open("rb") as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)

    return map_bytes


def packets(count=20, version=2):
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    made = []
    for k in range(count):
        message = mavlink.MAVLink_attitude_message(1000 * k, 0.1 * k, -0.2, 0.3, 0, 0, 0)
        packed = message.pack(sender, force_mavlink1=version == 1)
        made.append(struct.pack(">Q", START + 50_000 * k) + packed)
    return made


@pytest.mark.parametrize("version", [1, 2])
def test_what_pymavlink_packs_is_found(mapped, version):
    data = mapped(b"".join(packets(version=version)))
    frames = find_packets(data)
    assert set(frames.kinds.tolist()) == {mavlink.MAVLINK_MSG_ID_ATTITUDE}
    assert set(frames.senders.tolist()) == {257}
    np.testing.assert_allclose(np.diff(frames.received), 0.05, atol=1e-9)
    values = payloads(data, frames, mavlink.MAVLINK_MSG_ID_ATTITUDE)
    np.testing.assert_array_equal(values["roll"], (0.1 * np.arange(20)).astype(np.float32))
    np.testing.assert_array_equal(values["rollspeed"], 0)  # MAVLink 2 cuts zeros off the end
    assert (frames.skipped, frames.places, frames.unknown) == (0, 0, 0)


def test_a_wrong_checksum_costs_one_packet(mapped):
    made = packets()
    made[7] = made[7][:20] + bytes([made[7][20] ^ 1]) + made[7][21:]
    frames = find_packets(mapped(b"".join(made)))
    assert frames.kinds.size == 19
    assert (frames.skipped, frames.places) == (len(made[7]), 1)


def test_junk_and_a_cut_end(mapped):
    made = packets()
    junk = b"\xfd\xfe something else"
    frames = find_packets(mapped(b"".join([*made[:5], junk, *made[5:-1], made[-1][:-4]])))
    assert frames.kinds.size == 19
    assert frames.places == 2


def test_layouts_are_as_long_as_pymavlinks():
    """Of every message of the dialect."""
    for kind, known in KINDS.items():
        assert layout(kind).itemsize == known.unpacker.size, known.msgname


def unknown(version, payload=b"\x01\x02\x03", signed=False):
    """A packet of a kind that pymavlink does not know, with any checksum."""
    kind = next(k for k in range(255 if version == 1 else 60_000, 0, -1) if k not in KINDS)
    if version == 1:
        return bytes([0xFE, len(payload), 0, 1, 1, kind]) + payload + b"\xaa\xbb"
    head = bytes([0xFD, len(payload), int(signed), 0, 0, 1, 1]) + kind.to_bytes(3, "little")
    return head + payload + b"\xaa\xbb" + bytes(13 * signed)


@pytest.mark.parametrize(("version", "signed"), [(1, False), (2, False), (2, True)])
def test_packets_of_an_unknown_kind_are_sound_where_another_packet_follows(mapped, version, signed):
    made, stamp = packets(6), struct.pack(">Q", START)
    other = stamp + unknown(version, signed=signed)
    frames = find_packets(mapped(b"".join([*made[:3], other, *made[3:], other])))
    assert (frames.kinds.size, frames.unknown, frames.skipped) == (6, 2, 0)
    junk = b"neither"
    frames = find_packets(mapped(b"".join([*made[:3], other, junk, *made[3:]])))
    assert (frames.kinds.size, frames.unknown) == (6, 0)
    assert (frames.skipped, frames.places) == (len(other) + len(junk), 1)
    assert np.diff(frames.starts).max() == len(made[0]) + len(other) + len(junk)


def test_a_packet_ends_with_the_file_or_is_not_there(mapped):
    made = packets(3)
    whole = b"".join(made)
    for cut in (0, 1, 2, 3):
        frames = find_packets(mapped(whole[: len(whole) - cut]))
        assert frames.kinds.size == (3 if not cut else 2)
        assert frames.skipped == (0 if not cut else len(made[2]) - cut)
