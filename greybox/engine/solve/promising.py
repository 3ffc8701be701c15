"""Which of many starts are run first, and when the others are not needed."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Promising:
    """The most promising starts are run in waves, until enough of their ends agree.

    Attributes
    ----------
    runs : tuple of int
        How many starts have been run at the end of each wave; the rest is the last wave.
    agree : int
        How many runs must have ended at the best minimum for the next waves to be left out.
    """

    runs: tuple[int, ...]
    agree: int
