"""Packets as pymavlink packs them, whole, damaged and unknown."""

import mmap
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from greybox.data.logs.readers.telemetry_packets import Packets

START = 1_700_000_000_000_000  # µs since 1970
STAMP = struct.pack(">Q", START)


@pytest.fixture
def found(tmp_path):
    def find(data):
        path = tmp_path / "flight.tlog"
        path.write_bytes(data)
        with path.open("rb") as file:
            packets = Packets(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
        return [*packets], packets

    return find


def attitudes(count=6, version=2):
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    return [
        struct.pack(">Q", START + 50_000 * k)
        + mavlink.MAVLink_attitude_message(1000 * k, 0.1 * k, -0.2, 0.3, 0, 0, 0).pack(
            sender, force_mavlink1=version == 1
        )
        for k in range(count)
    ]


def unknown(version, payload=b"\x01\x02\x03", signed=False):
    """A packet of a kind that pymavlink does not know, with any checksum."""
    numbers = range(255 if version == 1 else 60_000, 0, -1)
    kind = next(k for k in numbers if k not in mavlink.mavlink_map)
    if version == 1:
        return bytes([0xFE, len(payload), 0, 1, 1, kind]) + payload + b"\xaa\xbb"
    head = bytes([0xFD, len(payload), int(signed), 0, 0, 1, 1]) + kind.to_bytes(3, "little")
    return head + payload + b"\xaa\xbb" + bytes(13 * signed)


@pytest.mark.parametrize("version", [1, 2])
def test_what_pymavlink_packs_is_found(found, version):
    packets, damage = found(b"".join(attitudes(version=version)))
    assert [received - START for received, _ in packets] == [50_000 * k for k in range(6)]
    assert [packet.roll for _, packet in packets] == pytest.approx([0.1 * k for k in range(6)])
    assert (damage.skipped, damage.places, damage.unknown) == (0, 0, 0)


def test_signed_packets_are_found(found):
    link = mavlink.MAVLink(None, srcSystem=254, srcComponent=3)
    link.signing.secret_key = bytes(32)
    link.signing.sign_outgoing = True
    signed = mavlink.MAVLink_vfr_hud_message(1.0, 1.5, 90, 30, 12.0, 0.5).pack(link)
    packets, damage = found((STAMP + signed) * 3)
    assert [packet.get_srcSystem() for _, packet in packets] == [254] * 3
    assert damage.skipped == 0


def test_the_highest_bit_of_a_time_is_a_flag(found):
    made = attitudes()
    flagged = bytes([0x80 | made[4][0]]) + made[4][1:]
    packets, _ = found(b"".join([*made[:4], flagged]))
    assert packets[4][0] == START + 200_000


def test_a_wrong_checksum_costs_one_packet(found):
    made = attitudes()
    made[3] = made[3][:20] + bytes([made[3][20] ^ 1]) + made[3][21:]
    packets, damage = found(b"".join(made))
    assert len(packets) == 5
    assert (damage.skipped, damage.places) == (len(made[3]), 1)


def test_junk_and_a_cut_end_are_skipped(found):
    made = attitudes()
    junk = b"\xfd\xfe something else"
    packets, damage = found(b"".join([*made[:3], junk, *made[3:-1], made[-1][:-4]]))
    assert len(packets) == 5
    assert damage.places == 2


@pytest.mark.parametrize(("version", "signed"), [(1, False), (2, False), (2, True)])
def test_packets_of_an_unknown_kind_are_sound_where_another_packet_follows(found, version, signed):
    made = attitudes()
    other = STAMP + unknown(version, signed=signed)
    packets, damage = found(b"".join([*made[:3], other, *made[3:], other]))
    assert (len(packets), damage.unknown, damage.skipped) == (6, 2, 0)

    junk = b"neither"
    packets, damage = found(b"".join([*made[:3], other, junk, *made[3:]]))
    assert (len(packets), damage.unknown) == (6, 0)
    assert (damage.skipped, damage.places) == (len(other) + len(junk), 1)


def test_after_damage_a_packet_of_a_known_kind_is_searched(found):
    """The checksum of an unknown packet says nothing."""
    made = attitudes()
    other = STAMP + unknown(2)
    broken = made[2][:12] + bytes([made[2][12] ^ 1]) + made[2][13:]
    packets, damage = found(b"".join([*made[:2], broken, other, *made[3:]]))
    assert (len(packets), damage.unknown) == (5, 0)
    assert (damage.skipped, damage.places) == (len(broken) + len(other), 1)


@pytest.mark.parametrize("version", [1, 2])
def test_a_packet_without_a_payload_may_end_the_file(found, version):
    empty = STAMP + unknown(version, payload=b"")
    packets, damage = found(b"".join([*attitudes(3), empty]))
    assert (len(packets), damage.unknown, damage.skipped) == (3, 1, 0)
