"""Values that another process builds again."""

from functools import partial
from typing import Any, Self


class Rebuilt:
    """A value that is pickled as its class and the arguments of its construction.

    What it has built since stays in this process: much of it cannot be pickled, such as memory of
    CasADi, and it would change the key of stored runs.
    """

    def __new__(cls, *arguments: Any, **options: Any) -> Self:
        """Remember the arguments."""
        value = super().__new__(cls)
        vars(value)["_recipe"] = partial(cls, **options), arguments
        return value

    def __reduce__(self) -> tuple[Any, ...]:
        return vars(self)["_recipe"]
