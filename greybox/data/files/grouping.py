"""Items in groups that are alike, and every item once."""

from collections.abc import Callable, Hashable, Iterable
from typing import TypeVar

Item = TypeVar("Item")


def grouped(items: Iterable[Item], key: Callable[[Item], Hashable]) -> list[list[Item]]:
    """Return the items in groups of one key, in the order of their first items."""
    groups: dict[Hashable, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return [*groups.values()]


def unique(items: Iterable[Item]) -> tuple[Item, ...]:
    """Return every item once, in the order in which they come first."""
    return tuple(dict.fromkeys(items))
