"""Layouts of the messages in a DataFlash log, which the log describes itself."""

from dataclasses import dataclass

import numpy as np
from pymavlink.DFReader import FORMAT_TO_STRUCT


@dataclass(frozen=True)
class Layout:
    """The layout of one message type: its bytes with the header, one letter for each column."""

    kind: int
    name: str
    length: int
    format: str
    columns: tuple[str, ...]

    @property
    def dtype(self) -> np.dtype:
        """The body as a packed numpy type, little-endian."""
        formats = (FORMAT_TO_STRUCT[letter][0] for letter in self.format)
        # The letters of `struct` are those of numpy, except that of texts: 16s is S16.
        types = (f"S{form[:-1]}" if form.endswith("s") else f"<{form}" for form in formats)
        return np.dtype([(f"f{i}", type_) for i, type_ in enumerate(types)])

    def scale(self, column: int) -> float | None:
        """Return the divisor of the letter: 100 for c, C, e and E, 1e7 for L, None for others."""
        multiplier = FORMAT_TO_STRUCT[self.format[column]][1]
        return None if multiplier is None else 1 / multiplier


def sound_layout(
    kind: int, name: str, length: int | None, letters: str, columns: tuple[str, ...]
) -> Layout | None:
    """Return the layout, or None if its letters, columns and length do not fit together.

    The length is None in logs of text.
    """
    # Bytes of other messages may look like a description.
    if not (
        name.isascii()
        and name.replace("_", "").isalnum()
        and all(c in FORMAT_TO_STRUCT for c in letters)
    ):
        return None
    layout = Layout(kind, name, length or 0, letters, columns)
    fits = len(columns) == len(letters) == len(set(columns))
    return layout if fits and length in (None, layout.dtype.itemsize + 3) else None
