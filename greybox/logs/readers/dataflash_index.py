"""Finds the messages in a DataFlash log, damaged ones included.

pymavlink has a compiled scan, but it terminates the Python process at the first message of an
unknown type or length, and prints a line for every byte that it skips. This one is about as fast,
silent, and counts what it skips. The table of format letters is pymavlink's.
"""

import struct
from array import array
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pymavlink.DFReader import FORMAT_TO_STRUCT

from greybox.files.arrays import IntArray
from greybox.files.progress import reading
from greybox.logs.readers.mapped_file import Bytes, release

HEAD = b"\xa3\x95"  # before every message, then the type's number
FMT = 0x80  # the message that describes the others: type, length, name, format, columns
FMT_LENGTH = 89
STRIDE = 256  # messages that are first tried at once; it doubles while all are sound
PIECE = 2**22  # bytes scanned for headers at once: 4 MB, against a log of gigabytes in memory
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


class _Scan:
    """The state of a scan: the descriptions and the messages so far."""

    def __init__(self, data: Bytes) -> None:
        self.data = data
        self.raw = np.frombuffer(data, dtype=np.uint8)
        self.layouts = [FMT_LAYOUT]
        self.lengths = np.zeros(256, dtype=np.int64)
        self.current = np.zeros(256, dtype=np.uint16)
        self.lengths[FMT] = FMT_LENGTH
        self.offsets = array("I" if len(data) <= 0xFFFFFFFF else "q")
        self.which = array("H")
        self.skipped = self.places = 0
        self.first = -1
        self.cut = ""
        self.piece = -1
        self.heads = np.empty(0, dtype=np.int64)

    def run(self) -> Index:
        """Scan the file: many messages at once where every header is in place, one by one elsewhere."""
        at = 0
        last = len(self.data) - 3
        with reading(len(self.data), "finding messages") as bar:
            while at <= last:
                at = self._stride(at)
                if at <= last:
                    at = self._step(at)
                if at - bar.n > PIECE:
                    bar.update(at - bar.n)
        return Index(
            tuple(self.layouts),
            np.asarray(self.offsets),
            np.asarray(self.which),
            self.skipped,
            self.places,
            self.first,
            self.cut,
        )

    def _stride(self, at: int) -> int:
        """Append messages that follow each other exactly, up to the next description or piece; return their end."""
        if at // PIECE != self.piece:
            release(self.data, self.piece * PIECE, at)
            self.piece = at // PIECE
            self.heads = _heads(self.raw, self.piece * PIECE)
        heads = self.heads
        position = int(np.searchsorted(heads, at))
        size = STRIDE
        while position + 1 < heads.size and heads[position] == at:
            starts = heads[position : position + size + 1]
            kinds = self.raw[starts[:-1] + 2]
            sound = (starts[:-1] + self.lengths[kinds] == starts[1:]) & (kinds != FMT)
            number = sound.size if sound.all() else int(sound.argmin())
            self._append(starts[:number], self.current[kinds[:number]])
            position += number
            at = int(starts[number])
            if number < sound.size:
                break
            size *= 2
        return at

    def _step(self, at: int) -> int:
        """Append the message at `at`, if there is one, and return where to continue."""
        head = self.data[at : at + 3]
        length = int(self.lengths[head[2]]) if head[:2] == HEAD else 0
        if not length:
            return self._recover(at)
        if at + length > len(self.data):
            self.cut = self.layouts[self.current[head[2]]].name
            return len(self.data)
        if head[2] == FMT:
            self._define(at)
        self._append(np.array([at]), self.current[head[2] : head[2] + 1])
        return at + length

    def _append(self, offsets: IntArray, which: NDArray[np.uint16]) -> None:
        self.offsets.frombytes(offsets.astype(self.offsets.typecode).tobytes())
        self.which.frombytes(which.tobytes())

    def _define(self, at: int) -> None:
        layout = _layout(self.data[at + 3 : at + FMT_LENGTH])
        if layout is None or layout.kind == FMT or len(self.layouts) == 0xFFFF:
            return
        if layout not in self.layouts:
            self.layouts.append(layout)
        self.lengths[layout.kind] = layout.length
        self.current[layout.kind] = self.layouts.index(layout)

    def _recover(self, at: int) -> int:
        """Return where to continue after bytes that start no known message; the previous one may be truncated."""
        if self.offsets:
            previous = self.offsets[-1]
            inside = self._next_sound(previous + 3, at)
            if inside >= 0:
                self.offsets.pop()
                self.which.pop()
                self._skip(previous, inside)
                return inside
        following = self._next_sound(at + 1, len(self.data))
        end = len(self.data) if following < 0 else following
        # A page of zeros or of erased flash at the end is no damage.
        rest = self.data[at : at + 4096]
        if following >= 0 or (rest.strip(b"\0") and rest.strip(b"\xff")):
            self._skip(at, end)
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
    return _Scan(data).run()


def sound_layout(
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
    names = tuple(column for column in text(columns).split(",") if column)
    return sound_layout(kind, text(name), length, text(letters), names)


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


def _numpy_type(letter: str) -> str:
    """Translate a letter of `struct` to numpy."""
    return (
        f"S{letter[:-1]}"
        if letter.endswith("s")
        else np.dtype(letter if letter != "e" else "f2").newbyteorder("<").str
    )
