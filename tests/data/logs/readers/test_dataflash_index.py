"""The scan for messages, on files that are whole, cut, torn and padded."""

import numpy as np
import pytest
from synthetic_logs import Log

from greybox.data.logs.readers.dataflash_index import index, text
from greybox.data.logs.readers.dataflash_layout import Layout, sound_layout


def log(count=600):
    made = Log(units=False).fmt("ATT", "Qf", "TimeUS,Roll")
    for k in range(count):
        made.add("ATT", k * 1000, k / 10)
    return made


def found(data):
    """Offsets of the messages named ATT."""
    scanned = index(data)
    numbers = [k for k, layout in enumerate(scanned.layouts) if layout.name == "ATT"]
    return scanned, scanned.offsets[np.isin(scanned.numbers, numbers)]


def skipped(scanned):
    return sum(end - start for start, end in scanned.damage)


def test_every_message_is_found_where_it_was_written():
    parts = log().parts
    starts = np.cumsum([0, *(len(part) for part in parts)])[:-1]
    scanned, offsets = found(b"".join(parts))
    np.testing.assert_array_equal(scanned.offsets, starts)
    assert offsets.size == 600
    assert (scanned.damage, scanned.cut) == ((), "")


@pytest.mark.parametrize("junk", [b"\x00" * 7, b"\xa3\x95", b"\xa3\x95\x33garbage"])
def test_junk_between_messages_is_skipped_and_counted(junk):
    parts = log().parts
    scanned, offsets = found(b"".join([*parts[:300], junk, *parts[300:]]))
    assert offsets.size == 600
    first = sum(map(len, parts[:300]))
    assert scanned.damage == ((first, first + len(junk)),)


def test_a_torn_message_takes_no_other_with_it():
    parts = log().parts
    torn = parts[300][:9]
    scanned, offsets = found(b"".join([*parts[:300], torn, *parts[301:]]))
    assert offsets.size == 599
    assert skipped(scanned) == len(torn)


def test_a_cut_end_is_named_and_padding_is_no_damage():
    data = b"".join(log().parts)
    assert found(data[:-3])[0].cut == "ATT"
    for pad in (b"\x00", b"\xff"):
        scanned, offsets = found(data + pad * 1000)
        assert offsets.size == 600
        assert not scanned.damage


def test_what_is_no_layout():
    assert sound_layout(1, "ATT", 15, "Qf", ("TimeUS", "Roll")) is not None
    assert sound_layout(1, "ATT", 16, "Qf", ("TimeUS", "Roll")) is None  # another length
    assert sound_layout(1, "A T", 15, "Qf", ("TimeUS", "Roll")) is None
    assert sound_layout(1, "ATT", 15, "Q?", ("TimeUS", "Roll")) is None
    assert sound_layout(1, "ATT", 15, "Qf", ("TimeUS", "TimeUS")) is None


def test_texts_end_at_the_first_zero():
    assert text(b"Roll\0\0x") == "Roll"
    assert text("°".encode("iso-8859-1")) == "°"


def test_damage_of_every_kind_is_found():
    """Messages of two lengths, a description in between, junk, a torn message, and a header at the very end."""
    made = Log(units=False).fmt("ATT", "Qf", "TimeUS,Roll").fmt("GPS", "QLLf", "TimeUS,Lat,Lng,Alt")
    rng = np.random.default_rng(0)
    for k in range(200):
        made.add("ATT", k * 1000, k / 10)
        if rng.random() < 0.3:
            made.add("GPS", k * 1000, 1.0, 2.0, 3.0)
        if k == 120:
            made.fmt("IMU", "Qff", "TimeUS,X,Y")
        if k > 120:
            made.add("IMU", k * 1000, 1.0, 2.0)
    parts = list(made.parts)
    starts, at, data, lost = [], 0, [], 0
    for k, part in enumerate(parts):
        if k in (20, 21, 90):
            data.append(b"\xa3\x95\x00junk")
            at += 7
            lost += 7
        if k == 60:  # torn after its header
            data.append(part[:9])
            at += 9
            lost += 9
            continue
        starts.append(at)
        data.append(part)
        at += len(part)
    scanned = index(b"".join([*data, b"\xa3"]))
    assert scanned.offsets.tolist() == starts
    names = [scanned.layouts[k].name for k in scanned.numbers]
    assert names.count("IMU") == 79
    assert names == [
        next(n for n, (kind, *_) in made.kinds.items() if kind == part[2])
        for k, part in enumerate(parts)
        if k != 60
    ]
    assert (skipped(scanned), len(scanned.damage), scanned.cut) == (lost, 4, "")
    assert scanned.damage[0][0] == sum(map(len, parts[:20]))


@pytest.mark.parametrize(("end", "offsets", "lost"), [
    (b"", 1, 5), (b"\xa3", 1, 5), (b"\xa3\x95", 1, 5), (b"\x00", 0, None), (b"\x95", 0, None),
])  # fmt: skip
def test_after_junk_a_message_counts_that_another_one_or_the_end_follows(end, offsets, lost):
    made = Log(units=False).fmt("ATT", "Qf", "TimeUS,Roll")
    head, made.parts = made.binary, []
    message = made.add("ATT", 1000, 0.5).binary
    scanned, found_ = found(head + b"junk!" + message + end)
    assert found_.size == offsets
    assert skipped(scanned) == (lost if lost is not None else len(b"junk!" + message + end))


@pytest.mark.parametrize(("length", "damage"), [(4096, False), (4097, False)])
def test_padding_is_told_by_a_page_of_it(length, damage):
    """Of zeros or of erased flash alone; one other byte in it is damage."""
    data = b"".join(log(3).parts)
    for pad in (b"\x00", b"\xff"):
        assert bool(index(data + pad * length).damage) is damage
    mixed = index(data + b"\x00" * 100 + b"\x01" + b"\x00" * 100)
    assert mixed.damage == ((len(data), len(data) + 201),)
    assert skipped(index(data + b"\x00\xff" * 50)) == 100


@pytest.mark.parametrize(
    ("letter", "divisor"), [("c", 100), ("C", 100), ("e", 100), ("E", 100), ("L", 1e7), ("f", None)]
)
def test_letters_of_scaled_integers_imply_a_divisor(letter, divisor):
    """ArduPilot's list of format characters: hundredths, and degrees times ten million."""
    layout = Layout(1, "X", 3, letter, ("x",))
    assert layout.scale(0) == (None if divisor is None else pytest.approx(divisor))


@pytest.mark.parametrize(
    ("letters", "size"),
    [
        ("bB", 2),
        ("hHcC", 8),
        ("iIeEL", 20),
        ("fd", 12),
        ("qQ", 16),
        ("nNZ", 84),
        ("a", 64),
        ("g", 2),
        ("M", 1),
    ],
)
def test_letters_are_as_long_as_their_numbers(letters, size):
    columns = tuple(f"x{k}" for k in range(len(letters)))
    layout = Layout(1, "X", size + 3, letters, columns)
    assert layout.dtype.itemsize == size
    assert sound_layout(1, "X_1", size + 3, letters, columns) == Layout(
        1, "X_1", size + 3, letters, columns
    )
    assert sound_layout(1, "X", size + 2, letters, columns) is None
    assert sound_layout(1, "°", size + 3, letters, columns) is None
