"""One result on a page."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from greybox.estimate.result import Fit


@dataclass(frozen=True, eq=False)
class Entry:
    """One result on the page.

    Attributes
    ----------
    label : str
        What it is called on the page.
    fit : Fit or None
        What details are shown of; None where there are none.
    kept : mapping
        The numbers of a result whose fit is not loaded, as `Fit.to_dict` gives them.
    file : str
        Where it was read.
    error : str
        Why there is no result.
    command : tuple of str
        The arguments of the command ``greybox`` that made it, with others.
    bootstrap : mapping
        What `Bootstrap.summary` says of one of this fit; empty where there is none.
    anchor : str
        Of its section; empty where it has none.
    """

    label: str
    fit: Fit | None
    kept: Mapping[str, Any] = field(default_factory=dict)
    file: str = ""
    error: str = ""
    command: tuple[str, ...] = ()
    bootstrap: Mapping[str, Any] = field(default_factory=dict)
    anchor: str = ""

    @cached_property
    def answer(self) -> Mapping[str, Any]:
        """The numbers of the result; empty where there is none."""
        return self.kept if self.fit is None else self.fit.to_dict()
