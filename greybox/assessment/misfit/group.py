"""All records, or all responses, as one regression: a term is missing in all of them alike."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from greybox.assessment.misfit.regression import Label, Regression
from greybox.assessment.misfit.term import RecordTerm, Term
from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.statistics.autoregressive_likelihood import (
    Outputs,
    autoregressive_p_values,
    whitened,
    whitening_filters,
)
from greybox.statistics.column_space import column_basis
from greybox.statistics.score_statistics import score_tests


@frozen
class Candidate:
    """A term that all parts may lack alike, None for a part without such a place."""

    label: Label
    by_part: Sequence[Term | None]

    @property
    def term(self) -> Term:
        """The term in one of the parts, for its words."""
        return [term for term in self.by_part if term][-1]

    @property
    def knots(self) -> int:
        """Number of knots of the function whose values may be missing, zero for a plain term."""
        return self.term.knots if isinstance(self.term, RecordTerm) else 0

    @property
    def place(self) -> str:
        """The state, output or input to which it adds."""
        return self.term.target or self.term.signal

    def on_knots(self, signals: Sequence[Array], knots: int) -> tuple[Array, "Candidate"]:
        """Return knots (c,) of signals of all parts, and the term of c functions in its place.

        Each function is one at one of the knots, and linear in between.
        """
        whole, shares = np.hstack(signals), np.linspace(0, 1, knots)
        # As many where samples are close together as over the whole range.
        evenly = whole.min() + shares * np.ptp(whole)
        at = (np.quantile(whole, shares) + evenly) / 2
        by_part = []
        for term, signal in zip(self.by_part, signals, strict=True):
            if isinstance(term, RecordTerm):
                hats = [np.interp(signal, at, hat) for hat in np.eye(knots)]
                by_part.append(replace(term, values=np.array(hats)))
            else:
                by_part.append(None)
        return at, Candidate(self.label, by_part)


@frozen
class Group:
    """All records, or all responses, in which a term is missing alike, as one regression.

    Attributes
    ----------
    parts : sequence of Regression
    residuals, fitted : (N, 1) and (N, d) arrays
        Residuals, and columns of the parameters, with the rows of all parts.
    outputs : sequence of sequences of (n,) arrays of int
        The rows of every output of records, by stretches.
    filters : sequence of (q + 1,) arrays
        What makes the residuals of every output white; none for responses.
    """

    parts: Sequence[Regression]
    residuals: Array
    fitted: Array
    outputs: Outputs
    filters: Sequence[Array]

    def columns(self, candidates: Sequence[Candidate]) -> Array:
        """Return the columns (N, c) of candidates, zero where a part lacks their place."""
        widths = [candidate.term.columns for candidate in candidates]
        blocks = []
        for k, part in enumerate(self.parts):
            terms = [candidate.by_part[k] for candidate in candidates]
            is_present = np.repeat([term is not None for term in terms], widths)
            block = np.zeros((sum(widths), len(part.residuals)))
            if is_present.any():
                block[is_present] = part.changes([term for term in terms if term]).T
            # Samples of a column are neighbors in memory, as filters need them.
            blocks.append(block.T)
        return np.vstack(blocks)

    def white(self, values: Array) -> Array:
        """Return values (N, c) in the rows (M, c) in which residuals are white."""
        return whitened(values, self.filters, self.outputs) if self.filters else values

    @cached_property
    def white_residuals(self) -> Array:
        """The residuals (M, 1), less what earlier samples predict."""
        return self.white(self.residuals)

    @cached_property
    def white_fitted(self) -> Array:
        """The columns (M, d) of the parameters, less what earlier samples predict."""
        return self.white(self.fitted)

    @cached_property
    def basis(self) -> Array:
        """An orthonormal basis (M, r) of what the parameters can take of white residuals."""
        return column_basis(self.white_fitted)

    def score_tests(self, columns: Array) -> Array:
        """Return the tests (c, 4) of columns (N, c) one by one, see `score_tests`."""
        return score_tests(self.white_residuals[:, 0], self.basis, self.white(columns)).T

    def autoregressive_p_values(self, effects: Sequence[Array]) -> Array:
        """Return the probabilities of the effects (N, q) of terms if errors are autoregressions."""
        # Where records have unlike outputs, errors of outputs count as independent.
        widths = {len(part.outputs) for part in self.parts}
        return autoregressive_p_values(
            self.residuals[:, 0],
            self.fitted,
            np.hstack([self.residuals[:, :0], *effects]),
            self.outputs,
            widths.pop() if len(widths) == 1 else 1,
            sum(part.lost for part in self.parts),
            [effect.shape[1] for effect in effects],
        )


def group_of(parts: Sequence[Regression]) -> Group:
    """Return parts as one regression."""
    residuals = np.vstack([part.residuals for part in parts])
    firsts = np.cumsum([0, *(len(part.residuals) for part in parts)])
    outputs = [
        [first + rows for rows in stretches]
        for first, part in zip(firsts, parts, strict=False)
        for stretches in part.outputs
    ]
    fitted = np.vstack([part.fitted for part in parts])
    return Group(parts, residuals, fitted, outputs, whitening_filters(residuals[:, 0], outputs))


def candidates_of(parts: Sequence[Regression], is_whole: bool) -> list[Candidate]:
    """Return the terms that parts may lack; `is_whole` if their fit can change all values.

    With two parts, either one may need another value; a single part has no counterpart. Beside the
    values of both, next to nothing would be left of an effect in the part that decides them.
    """
    decisive = max(parts, key=lambda part: np.linalg.norm(part.fitted))
    has_counterpart = len(parts) > 2 or not is_whole
    candidates = []
    for label in _labels(parts):
        candidate = Candidate(label, [part.terms.get(label) for part in parts])
        if candidate.term.is_of_part and not has_counterpart and label in decisive.terms:
            continue
        candidates.append(candidate)
    return candidates


def _labels(parts: Iterable[Regression]) -> dict[Label, None]:
    """Return the labels of all terms, in their order."""
    return {label: None for part in parts for label in part.terms}
