"""Bars for the progress of long work, with the time left, on a terminal and after two seconds."""

from collections.abc import Iterable
from typing import Any, TypeVar

from tqdm import tqdm

DELAY = 2  # s, before which no bar is worth a look

Item = TypeVar("Item")


def reading(size: int, what: str) -> Any:
    """Return the bar of a file of `size` bytes; ``bar.update(done - bar.n)`` says how far it is."""
    return tqdm(
        total=size, desc=what, unit="B", unit_scale=True, disable=None, delay=DELAY, leave=False
    )


def counted_off(items: Iterable[Item], what: str, unit: str) -> Iterable[Item]:
    """Yield the items, with a bar of how many are done."""
    return tqdm(items, desc=what, unit=unit, disable=None, delay=DELAY, leave=False)
