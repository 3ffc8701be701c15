"""Progress bars with the remaining time, on terminals only and after two seconds."""

from collections.abc import Iterable
from typing import Any, TypeVar

from tqdm import tqdm

DELAY = 2  # s, before which no bar is worth a look

Item = TypeVar("Item")


def reading(size: int, what: str) -> Any:
    """Return the bar of a file of `size` bytes; ``bar.update(done - bar.n)`` moves it."""
    return tqdm(
        total=size, desc=what, unit="B", unit_scale=True, disable=None, delay=DELAY, leave=False
    )


def counted_off(items: Iterable[Item], what: str, unit: str) -> Iterable[Item]:
    """Yield the items under a progress bar."""
    return tqdm(items, desc=what, unit=unit, disable=None, delay=DELAY, leave=False)
