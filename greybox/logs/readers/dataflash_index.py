"""Finds the messages in a DataFlash log, damaged ones included.

pymavlink has a compiled scan, but it terminates the Python process at the first message of an
unknown type or length, and prints a line for every byte that it skips. This one is about as fast,
silent, and counts what it skips. The table of format letters is pymavlink's.
"""

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.DFReader import FORMAT_TO_STRUCT

from greybox.files.arrays import IntArray
from greybox.files.progress import reading
from greybox.logs.readers.mapped_file import Bytes, release

HEAD = b"\xa3\x95"  # before every message, then the type's number
FMT, FMT_LENGTH = (
    0x80,
    89,
)  # the message that describes the others: type, length, name, format, columns
STRIDE = 256  # messages that are first tried at once; doubled while all are sound, so that any value serves
PIECE = 2**22  # bytes scanned for headers at once: 4 MB, against a log of gigabytes in memory
PADDING = 4096  # bytes behind the last message that are looked at: a page of zeros or of erased flash is no damage
FMT_BODY = struct.Struct("<BB4s16s64s")


@dataclass(frozen=True)
class Layout:
    """How the messages of one type are laid out: name, length in bytes with the header, one format letter a column."""

    kind: int
    name: str
    length: int
    format: str
    columns: tuple[str, ...]

    @property
    def dtype(self) -> np.dtype:
        """The body as a packed numpy type, little-endian."""
        letters = [FORMAT_TO_STRUCT[letter][0] for letter in self.format]
        return np.dtype([(f"f{i}", _numpy_type(letters[i])) for i in range(len(letters))])

    def scale(self, column: int) -> float | None:
        """Return the divisor that the letter implies (centi for c, C, e, E; 1e7 for L), None without one."""
        multiplier = FORMAT_TO_STRUCT[self.format[column]][1]
        return None if multiplier is None else 1 / multiplier


FMT_LAYOUT = Layout(
    FMT, "FMT", FMT_LENGTH, "BBnNZ", ("Type", "Length", "Name", "Format", "Columns")
)


@dataclass(frozen=True, eq=False)
class Index:
    """Offsets of all sound messages, in the order of the file, and what was wrong.

    Attributes
    ----------
    layouts : tuple of Layout
        Every description in the file; one type may have several that differ.
    offsets : (n,) array
        Where each message starts, bytes; in four bytes where that is enough.
    which : (n,) array
        Its layout, as an index.
    skipped, places, first : int
        Bytes that belong to no message, in how many places, and where the first is.
    cut : str
        Name of a last message that is not complete.
    """

    layouts: tuple[Layout, ...]
    offsets: IntArray
    which: NDArray[np.uint16]
    skipped: int
    places: int
    first: int
    cut: str

    def of(self, layout: int) -> IntArray:
        """Numbers of the messages of one layout, in the order of the file."""
        return np.flatnonzero(self.which == layout)


class _Growing:
    """An array that is appended to in place: of ten million messages, arrays to join would be in memory twice."""

    def __init__(self, dtype: Any) -> None:
        self.values = np.empty(1024, dtype)
        self.size = 0

    def append(self, more: NDArray[Any]) -> None:
        """Append values."""
        end = self.size + more.size
        if end > self.values.size:
            self.values.resize(max(end, 2 * self.values.size), refcheck=False)
        self.values[self.size : end] = more
        self.size = end

    def trimmed(self) -> NDArray[Any]:
        """Return the values; nothing can be appended afterwards."""
        self.values.resize(self.size, refcheck=False)
        return self.values


class _Walk:
    """State of the scan: the descriptions so far, and the messages found."""

    def __init__(self, data: Bytes) -> None:
        self.data = data
        self.raw = np.frombuffer(data, dtype=np.uint8)
        self.layouts = [FMT_LAYOUT]
        self.lengths = np.zeros(256, dtype=np.int64)
        self.current = np.zeros(256, dtype=np.uint16)
        self.lengths[FMT] = FMT_LENGTH
        self.offsets = _Growing(np.uint32 if len(data) <= 0xFFFFFFFF else np.int64)
        self.which = _Growing(np.uint16)
        self.skipped = self.places = 0
        self.first = -1
        self.cut = ""
        self.piece = -1
        self.heads = np.empty(0, dtype=np.int64)

    def run(self) -> Index:
        """Go from message to message: many at once where every header is where it should be, one by one elsewhere."""
        at = 0
        last = len(self.data) - 3
        with reading(len(self.data), "finding messages") as bar:
            while at <= last:
                at = self._stride(at)
                if at <= last:
                    at = self._step(at)
                if at - bar.n > PIECE:
                    bar.update(at - bar.n)
        found = self.offsets.trimmed(), self.which.trimmed()
        return Index(tuple(self.layouts), *found, self.skipped, self.places, self.first, self.cut)

    def _stride(self, at: int) -> int:
        """Take messages that follow each other exactly, up to the next description or piece; return where to go on."""
        if at // PIECE != self.piece:
            release(self.data, self.piece * PIECE, at)
            self.piece = at // PIECE
            self.heads = _heads(self.raw, self.piece * PIECE)
        heads = self.heads
        here = int(np.searchsorted(heads, at))
        size = STRIDE
        while here + 1 < heads.size and heads[here] == at:
            starts = heads[here : here + size + 1]
            kinds = self.raw[starts[:-1] + 2]
            good = (starts[:-1] + self.lengths[kinds] == starts[1:]) & (kinds != FMT)
            number = good.size if good.all() else int(good.argmin())
            self._take(starts[:number], self.current[kinds[:number]])
            here = here + number
            at = int(starts[number])
            if number < good.size:
                break
            size *= 2
        return at

    def _step(self, at: int) -> int:
        """Take the message at `at`, if it is one, and return where to continue."""
        head = self.data[at : at + 3]
        length = int(self.lengths[head[2]]) if head[:2] == HEAD else 0
        if not length:
            return self._recover(at)
        if at + length > len(self.data):
            self.cut = self.layouts[self.current[head[2]]].name
            return len(self.data)
        if head[2] == FMT:
            self._define(at)
        self._take(np.array([at]), self.current[head[2] : head[2] + 1])
        return at + length

    def _take(self, offsets: IntArray, which: NDArray[np.uint16]) -> None:
        self.offsets.append(offsets)
        self.which.append(which)

    def _drop_last(self) -> None:
        """Forget the message taken last."""
        self.offsets.size -= 1
        self.which.size -= 1

    def _define(self, at: int) -> None:
        layout = _layout(self.data[at + 3 : at + FMT_LENGTH])
        if layout is None or layout.kind == FMT or len(self.layouts) == 0xFFFF:
            return
        if layout not in self.layouts:
            self.layouts.append(layout)
        self.lengths[layout.kind] = layout.length
        self.current[layout.kind] = self.layouts.index(layout)

    def _recover(self, at: int) -> int:
        """Return where to continue after bytes that start no known message; the message before may be truncated."""
        start = at
        if self.offsets.size:
            before = int(self.offsets.values[self.offsets.size - 1])
            inside = self._next_sound(before + 3, at)
            if inside >= 0:
                self._drop_last()
                self._skip(before, inside)
                return inside
        found = self._next_sound(at + 1, len(self.data))
        end = len(self.data) if found < 0 else found
        if found >= 0 or not _is_padding(self.data[at : at + PADDING]):
            self._skip(start, end)
        return end

    def _next_sound(self, start: int, end: int) -> int:
        """Return the first header in start..end of a known type whose message another one, or the end, follows."""
        data = self.data
        size = len(self.data)
        at = data.find(HEAD, start, min(end + 2, size))
        while at >= 0:
            length = int(self.lengths[data[at + 2]]) if at + 2 < size else 0
            if length and (
                at + length >= size
                or data[at + length : at + length + 2] == HEAD[: size - at - length]
            ):
                return at
            at = data.find(HEAD, at + 1, min(end + 2, size))
        return -1

    def _skip(self, start: int, end: int) -> None:
        self.first = start if self.first < 0 else self.first
        self.skipped += end - start
        self.places += 1


def index(data: Bytes) -> Index:
    """Find every message in `data`."""
    return _Walk(data).run()


def sound(
    kind: int, name: str, length: int, letters: str, columns: tuple[str, ...]
) -> Layout | None:
    """Return the layout if it is plausible: known letters, a name, as many columns, and the length that they need."""
    if not (
        name.isascii()
        and name.replace("_", "").isalnum()
        and all(c in FORMAT_TO_STRUCT for c in letters)
    ):
        return None
    layout = Layout(kind, name, length, letters, columns)
    fits = len(columns) == len(letters) == len(set(columns)) and layout.dtype.itemsize + 3 == length
    return layout if fits else None


def _layout(body: bytes) -> Layout | None:
    kind, length, name, letters, columns = FMT_BODY.unpack(body)
    listed = tuple(column for column in text(columns).split(",") if column)
    return sound(kind, text(name), length, text(letters), listed)


def text(raw: bytes) -> str:
    """Return a text field up to its first zero byte, decoded as pymavlink does."""
    raw = raw.partition(b"\0")[0]
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("iso-8859-1")


def _heads(raw: NDArray[np.uint8], start: int) -> IntArray:
    """Return the offsets in the piece at `start` of the two bytes of a header with room for a third."""
    piece = raw[start : min(start + PIECE, raw.size - 2) + 1]
    at = np.flatnonzero(piece[:-1] == HEAD[0])
    return at[piece[at + 1] == HEAD[1]] + start


def _is_padding(raw: bytes) -> bool:
    return not raw.strip(b"\0") or not raw.strip(b"\xff")


def _numpy_type(letter: str) -> str:
    """Translate a letter of `struct` to numpy."""
    return (
        f"S{letter[:-1]}"
        if letter.endswith("s")
        else np.dtype(letter if letter != "e" else "f2").newbyteorder("<").str
    )
