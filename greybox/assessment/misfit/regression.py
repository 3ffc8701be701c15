"""A part as a regression of its residuals on what the model has and on what it may lack."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from greybox.assessment.misfit.answer import FALSE_ALARMS, Cause
from greybox.assessment.misfit.term import Family, Term
from greybox.data.files.arrays import Array, ComplexArray
from greybox.data.files.frozen_values import frozen
from greybox.statistics.autoregressive_likelihood import Outputs

TINY = 1e-300


@dataclass(frozen=True)
class Label:
    """Which term it is: the same in all parts that may lack it."""

    family: Family
    number: int


@frozen
class Regression:
    """A part as a regression of its residuals on the parameters of the fit and on missing terms.

    Attributes
    ----------
    measured, residuals : (N, 1) arrays
    fitted : (N, d) array
        What the parameters of the fit can take.
    terms : mapping of Label to Term
    changes : function
        Returns the columns (N, c) of terms.
    again : function or None
        Returns the residuals and slopes (N, 1 + d + q) of a response at changes (d,) of the
        parameters, multiplied by the first of (1 + q, n) factors; the others are those at the next
        numbers of a term.
    outputs : sequence of sequences of (n,) arrays of int
        The rows of every output of a record, by stretches.
    causes : sequence of Cause
        Those that are judged otherwise than the terms.
    is_unstable : bool
        Whether the model of a record is unstable.
    known : (N, e) array or None
        What is fitted beside the parameters, such as the ends of a manoeuvre.
    lost : int
        Degrees of freedom that all columns have lost.
    pieces : int
        Number of pieces of the rows of a response, in which neighbors may be correlated.
    level : float
        Probability below which the model does not explain the part.
    signals : function
        Returns the signals over which the shape of a term is drawn.
    """

    measured: Array
    residuals: Array
    fitted: Array
    terms: Mapping[Label, Term]
    changes: Callable[[Sequence[Any]], Array]
    again: Callable[[Array, ComplexArray], Array] | None = None
    outputs: Outputs = ()
    causes: Sequence[Cause] = ()
    is_unstable: bool = False
    known: Array | None = None
    lost: int = 0
    pieces: int = 2
    level: float = FALSE_ALARMS
    signals: Callable[[], Mapping[str, Array]] = dict


def labeled(terms: Iterable[Term]) -> dict[Label, Term]:
    """Return terms by their family and their number in it, the same in all parts."""
    numbered: dict[Label, Term] = {}
    counts = Counter[Family]()
    for term in terms:
        numbered[Label(term.family, counts[term.family])] = term
        counts[term.family] += 1
    return numbered
