"""The scan for messages, on files that are whole, cut, torn and padded."""

import numpy as np
import pytest
from synthetic_logs import Log

from greybox.logs.readers.dataflash_index import index, sound, text


def log(count=600):
    made = Log(units=False).fmt("ATT", "Qf", "TimeUS,Roll")
    for k in range(count):
        made.add("ATT", k * 1000, k / 10)
    return made


def found(data):
    """Offsets of the messages named ATT."""
    scanned = index(data)
    numbers = [k for k, layout in enumerate(scanned.layouts) if layout.name == "ATT"]
    return scanned, scanned.offsets[np.isin(scanned.which, numbers)]


def test_every_message_is_found_where_it_was_written():
    parts = log().parts
    starts = np.cumsum([0, *(len(part) for part in parts)])[:-1]
    scanned, offsets = found(b"".join(parts))
    np.testing.assert_array_equal(scanned.offsets, starts)
    assert offsets.size == 600
    assert (scanned.skipped, scanned.places, scanned.cut) == (0, 0, "")


@pytest.mark.parametrize("junk", [b"\x00" * 7, b"\xa3\x95", b"\xa3\x95\x33garbage"])
def test_junk_between_messages_is_skipped_and_counted(junk):
    parts = log().parts
    scanned, offsets = found(b"".join([*parts[:300], junk, *parts[300:]]))
    assert offsets.size == 600
    assert (scanned.skipped, scanned.places) == (len(junk), 1)
    assert scanned.first == sum(map(len, parts[:300]))


def test_a_torn_message_takes_no_other_with_it():
    parts = log().parts
    torn = parts[300][:9]
    scanned, offsets = found(b"".join([*parts[:300], torn, *parts[301:]]))
    assert offsets.size == 599
    assert scanned.skipped == len(torn)


def test_a_cut_end_is_named_and_padding_is_no_damage():
    data = b"".join(log().parts)
    assert found(data[:-3])[0].cut == "ATT"
    for pad in (b"\x00", b"\xff"):
        scanned, offsets = found(data + pad * 1000)
        assert offsets.size == 600
        assert scanned.skipped == 0


def test_what_is_no_layout():
    assert sound(1, "ATT", 15, "Qf", ("TimeUS", "Roll")) is not None
    assert sound(1, "ATT", 16, "Qf", ("TimeUS", "Roll")) is None  # another length
    assert sound(1, "A T", 15, "Qf", ("TimeUS", "Roll")) is None
    assert sound(1, "ATT", 15, "Q?", ("TimeUS", "Roll")) is None
    assert sound(1, "ATT", 15, "Qf", ("TimeUS", "TimeUS")) is None


def test_texts_end_at_the_first_zero():
    assert text(b"Roll\0\0x") == "Roll"
    assert text("°".encode("iso-8859-1")) == "°"
