"""One result on a page."""

import re
from dataclasses import field
from functools import cached_property

from greybox.estimate.result import Fit
from greybox.files.arrays import Named, frozen


@frozen
class Entry:
    """One result on the page.

    Attributes
    ----------
    label : str
        Its name on the page.
    fit : Fit or None
        None if the page shows no details.
    numbers : mapping
        `Fit.to_dict` of a result whose fit is not loaded.
    error : str
        Why there is no result.
    """

    label: str
    fit: Fit | None
    numbers: Named = field(default_factory=dict)
    error: str = ""

    @cached_property
    def answer(self) -> Named:
        """`Fit.to_dict` of the result; empty if there is none."""
        return self.numbers if self.fit is None else self.fit.to_dict()

    @property
    def anchor(self) -> str:
        """Identifier of the section with details; empty if there is none."""
        return "" if self.fit is None else "result-" + re.sub(r"\W+", "-", self.label)
