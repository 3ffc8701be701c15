"""Fields of a frozen value in their final form."""

from typing import Any


def normalize(value: Any, **fields: Any) -> None:
    """Set fields of a frozen value in their final form, while it is made.

    A user may leave a field out, or state it in several ways; the value holds it in one. Only the
    `__post_init__` of the value's class may call this: nothing is changed after a value is made.
    """
    for name, final in fields.items():
        object.__setattr__(value, name, final)
