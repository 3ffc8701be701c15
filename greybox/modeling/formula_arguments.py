"""The arguments of a formula: values by name."""

from collections.abc import Iterator, Mapping
from typing import Any

from greybox.data.files.spelling import alternatives


class Names(Mapping[str, Any]):
    """Values by name, ``p.a1`` or ``p["a1"]``: the arguments of a formula."""

    def __init__(self, values: Mapping[str, Any], what: str = "it") -> None:
        self.__dict__.update(values)
        self.__dict__["_what"] = what

    def __getattr__(self, name: str) -> Any:
        # `copy` and `pickle` look for special methods before there are any values.
        if name.startswith("__"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as error:
            raise AttributeError(*error.args) from None

    def __getitem__(self, name: str) -> Any:
        # A mapping raises KeyError. The values have no numbers, only names.
        if name not in self.__dict__:
            raise KeyError(f"{self._what} has no {name!r}; it has {alternatives(name, self)}")
        return self.__dict__[name]

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{name!r} cannot be set: these values are read-only.")

    def __iter__(self) -> Iterator[str]:
        return (name for name in self.__dict__ if name != "_what")

    def __len__(self) -> int:
        return len(self.__dict__) - 1

    def __repr__(self) -> str:
        return f"Names({dict(self)!r})"
