"""Names and counts as words of a sentence."""

from collections.abc import Sequence


def counted(count: float, singular: str, plural: str = "") -> str:
    """Return "1 record" or "2 records"; `plural` is an irregular one."""
    amount = f"{count:g}" if isinstance(count, float) else f"{count}"
    return f"{amount} {singular if count == 1 else plural or singular + 's'}"


def capitalized(sentence: str) -> str:
    """Return a sentence with a capital letter at its beginning."""
    return sentence[:1].upper() + sentence[1:]


def listed(names: Sequence[str]) -> str:
    """Return "a", "a and b" or "a, b and c"."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def numbered_where_alike(names: Sequence[str]) -> list[str]:
    """Return the names, with numbers in those that several have: y/u 1, y/u 2."""
    return [
        f"{name} {names[:k].count(name)}" if names.count(name) > 1 else name
        for k, name in enumerate(names, 1)
    ]


def some(names: Sequence[str], most: int = 4) -> str:
    """Return names as `listed` does; of many names, the first ones and the number of the others."""
    return (
        listed(names)
        if len(names) <= most + 1
        else f"{', '.join(names[:most])} and {len(names) - most} more"
    )
