"""All families of cases, those whose differences are known, and how one case is run.

A case is a family and a number: the number seeds every random choice, so the two repeat it.
"""

import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from differential import records, relations, responses

FAMILIES: dict[str, Callable[[np.random.Generator], str | None]] = {
    **records.FAMILIES,
    **responses.FAMILIES,
    **relations.FAMILIES,
}

# Families that differ for a reason that is known and not mended yet. The command runs them all the
# same; the sample of the test suite leaves them out. Whoever mends one removes its line.
OPEN = {
    "fit-worse-clock": "a new stretch behind lost rows has free initial states, which may cost more "
    "than four times the precision",
}


@dataclass(frozen=True)
class Difference:
    """A case whose answer is not that of its reference."""

    family: str
    case: int
    text: str

    def __str__(self) -> str:
        """Return one line, with the options that repeat the case."""
        known = " (open)" if self.family in OPEN else ""
        text = " ".join(self.text.split())
        return f"{self.family}{known}: {text}  [--only {self.family} --case {self.case}]"


def run(family: str, case: int) -> Difference | None:
    """Return how the case differs. An exception is a difference, too."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            text = FAMILIES[family](np.random.default_rng(case))
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(last.filename).name}:{last.lineno}"
            text = f"{type(error).__name__} in {place}: {str(error)[:200]}"
    return Difference(family, case, text) if text else None
