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


def test_reception_counts_from_the_median_packet(mapped, monkeypatch):
    """In µs since 1970, whose highest bit is a flag; of a long log the median of a sample of them."""
    made = packets(21)
    made[4] = (0x80 | made[4][0]).to_bytes(1, "big") + made[4][1:]
    data = mapped(b"".join(made))
    assert find_packets(data).received == pytest.approx(0.05 * (np.arange(21) - 10), abs=1e-12)
    monkeypatch.setattr("greybox.logs.readers.telemetry_frames.SAMPLED", 4)
    monkeypatch.setattr("greybox.logs.readers.telemetry_frames.PIECE", 40)
    assert find_packets(data).received == pytest.approx(
        0.05 * (np.arange(21) - 10), abs=1e-12
    )  # of 0, 5, 10, 15, 20


def test_senders_and_numbers_are_those_of_the_header(mapped):
    """Systems and components up to 255, a kind beyond 255, signed and not."""
    link = mavlink.MAVLink(None, srcSystem=254, srcComponent=3)
    message = mavlink.MAVLink_rc_channels_scaled_message(1000, 1, *range(8), 200)
    wide = mavlink.MAVLink_esc_telemetry_1_to_4_message(
        *[[k, k + 1, k + 2, k + 3] for k in range(6)]
    )
    plain = [
        one.pack(link, force_mavlink1=first)
        for one, first in ((message, True), (message, False), (wide, False))
    ]
    link.signing.secret_key, link.signing.sign_outgoing = bytes(32), True
    signed = message.pack(link)
    assert len(signed) == len(plain[1]) + 13
    stamp = struct.pack(">Q", START)
    every = [*plain, signed]
    frames = find_packets(mapped(b"".join(stamp + one for one in every)))
    assert frames.kinds.tolist() == [34, 34, 11030, 34]
    assert frames.senders.tolist() == [254 * 256 + 3] * 4
    assert frames.lengths.tolist() == [one[1] for one in every]
    ends = np.cumsum([8 + len(one) for one in every])
    assert frames.starts.tolist() == [
        end - len(one) + head for end, one, head in zip(ends, every, (6, 10, 10, 10), strict=True)
    ]
    assert (frames.skipped, frames.places, frames.unknown) == (0, 0, 0)
    values = payloads(mapped(b"".join(stamp + one for one in every)), frames, 11030)
    assert values["temperature"].tolist() == [[0, 1, 2, 3]]
    assert values["count"].tolist() == [[5, 6, 7, 8]]


@pytest.mark.parametrize("window", [30, 64, 101])
def test_packets_across_windows_are_decoded_as_in_one(mapped, monkeypatch, window):
    """Of two lengths and two kinds; a window may begin and end within a packet, or hold none."""
    rng = np.random.default_rng(window)
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    made, angles = [], []
    for k in range(30):
        roll, last = rng.normal(), rng.normal() * (k % 3 == 0)  # zeros at the end are not sent
        angles.append((roll, last))
        made.append(mavlink.MAVLink_attitude_message(k, roll, 0, 0, 0, 0, last).pack(sender))
        made += [mavlink.MAVLink_vfr_hud_message(k, 1.5, 90, 30, 12.0, 0.5).pack(sender)] * int(
            rng.integers(0, 4)
        )
    data = mapped(b"".join(struct.pack(">Q", START) + one for one in made))
    frames = find_packets(data)
    monkeypatch.setattr("greybox.logs.readers.telemetry_frames.WINDOW", window)
    values = payloads(data, frames, mavlink.MAVLINK_MSG_ID_ATTITUDE)
    assert values["time_boot_ms"].tolist() == list(range(30))
    np.testing.assert_array_equal(
        np.stack([values["roll"], values["yawspeed"]], axis=1), np.float32(angles)
    )
    one = payloads(data, frames, mavlink.MAVLINK_MSG_ID_ATTITUDE, "roll")
    np.testing.assert_array_equal(one, values["roll"])


def test_after_damage_a_packet_of_a_known_kind_is_searched(mapped):
    """An unknown one is no place to go on: its checksum says nothing."""
    made, stamp = packets(6), struct.pack(">Q", START)
    other = stamp + unknown(2)
    broken = made[2][:12] + bytes([made[2][12] ^ 1]) + made[2][13:]
    frames = find_packets(mapped(b"".join([*made[:2], broken, other, *made[3:]])))
    assert (frames.kinds.size, frames.unknown) == (5, 0)
    assert (frames.skipped, frames.places) == (len(broken) + len(other), 1)


def test_a_packet_without_a_payload_may_end_the_file(mapped):
    """Of the first version, eight bytes; of the second, twelve."""
    for version in (1, 2):
        empty = unknown(version, payload=b"")
        assert len(empty) == (8 if version == 1 else 12)
        frames = find_packets(mapped(b"".join([*packets(3), struct.pack(">Q", START), empty])))
        assert (frames.kinds.size, frames.unknown, frames.skipped) == (3, 1, 0)
