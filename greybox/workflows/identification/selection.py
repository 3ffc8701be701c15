"""Fitted structures side by side: the smallest that the data support, and the verdict."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from greybox.assessment.result import Fit
from greybox.assessment.validation.measures import relative_rms
from greybox.assessment.validation.parsimony import parsimony
from greybox.assessment.validation.same_data import count_unknowns
from greybox.data.files.folded_text import folded
from greybox.data.files.frozen_values import frozen
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import one_line
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import counted, listed

NO_FIT = (
    "No structure has a fit: leave out frequencies at which the response is not that of a linear "
    "vehicle (band=...), or state the structures."
)

# A structure does not explain the data if its residuals exceed the noise by the first factor of a
# pair, and the part that is not noise exceeds the second share of the response. Residuals of
# adequate models scatter about 1, of few points up to 1.5; a model within 5 % of the response is
# useful whatever the noise.
LIMITS = ((3.0, 0.05), (1.5, 0.3))
# Share of the response that the residuals may have if the noise is unknown.
LIMIT_WITHOUT_NOISE = 0.3

# Structures that a short answer shows.
BRIEF = 3
# The beginning of a remark on an unstable pole.
UNSTABLE = "unstable pole"
# Difference of BIC by which a structure with an unstable pole must be better: beside a zero, such a
# pole imitates noise, and few vehicles have one. A difference of 6 is strong evidence (Kass and
# Raftery 1995).
PENALTY_OF_UNSTABLE = 6.0


@frozen
class Candidate:
    """A fitted structure.

    Attributes
    ----------
    label : str
        The structure as a person or the command line names it.
    fit : Fit
    about : str
        What the structure describes.
    remarks : tuple of str
        Poles and zeros that nearly cancel, unstable poles, parameters at a bound.
    """

    label: str
    fit: Fit
    about: str = ""
    remarks: tuple[str, ...] = ()

    @property
    def noise(self) -> float:
        """Size of the residuals over that of the noise; NaN where the data have no variances."""
        variances = [part.data.variance for part in self.fit.responses]
        if not self.fit.converged or any(variance is None for variance in variances):
            return math.nan
        # A variance is E|P̂ - P|² of both components, so that one complex residual counts once.
        squares_of_parts = []
        for part in self.fit.responses:
            residual = part.data.response - part.response
            squares_of_parts.append(np.abs(residual) ** 2 / part.data.variance)
        squares = np.concatenate(squares_of_parts)
        dof = squares.size - len(self.fit.free) / 2
        return math.sqrt(float(squares.sum()) / max(dof, 0.5))

    @property
    def unstable(self) -> bool:
        """Whether the structure has an unstable pole."""
        return any(remark.startswith(UNSTABLE) for remark in self.remarks)

    @property
    def misfit(self) -> float:
        """Size (rms) of the residuals over that of the response."""
        return relative_rms(self.fit)

    @property
    def explains(self) -> bool:
        """Whether the structure explains the data, given the noise."""
        if math.isnan(self.noise):
            return self.misfit <= LIMIT_WITHOUT_NOISE
        # The part of the misfit that the noise does not explain.
        beyond_noise = self.misfit * math.sqrt(max(0.0, 1 - 1 / self.noise**2))
        return all(self.noise <= factor or beyond_noise <= share for factor, share in LIMITS)


@public
@frozen
class Selection:
    """Structures that were fitted to the same data. Printing it gives the table and the verdict.

    Attributes
    ----------
    candidates : tuple of Candidate
    chosen : Candidate or None
        The candidate with the fewest parameters among those whose BIC is within 2 of the least;
        None where no structure has a fit.
    bic : tuple of float
        BIC of every candidate; NaN without a fit.
    reason : str
        Why this candidate is chosen, in a sentence.
    note : str
        Structures that were not fitted, in words.
    """

    candidates: tuple[Candidate, ...]
    chosen: Candidate | None
    bic: tuple[float, ...]
    reason: str
    note: str

    @property
    def fit(self) -> Fit | None:
        """The fit of the chosen structure; it warns if the structure does not explain the data."""
        if self.chosen is None:
            return None
        fit = self.chosen.fit
        if self.explains:
            return fit
        # The fit has the warning, since it is saved and reported without this selection.
        text = "the structure does not explain the data: do not use its parameters."
        return replace(fit, warnings=(text, *fit.warnings))

    @property
    def explains(self) -> bool:
        """Whether there is a structure, and it explains the data."""
        return self.chosen is not None and self.chosen.explains

    @property
    def verdict(self) -> str:
        """The structure that the data support, and whether it explains them."""
        if self.chosen is None:
            return self.reason
        size = f"{number(100 * self.chosen.misfit, 2)} % of the response (rms)"
        if not math.isnan(self.chosen.noise):
            size = f"{number(self.chosen.noise, 2)} times the noise and {size}"
        if self.explains:
            return f"{self.reason} Its residuals are {size}."
        return (
            f"No structure explains the data: the residuals of the best one are {size}. Its "
            f"parameters describe no vehicle. ({self.reason})"
        )

    def __repr__(self) -> str:
        label = self.chosen.label if self.chosen else "no fit"
        return one_line(self, counted(len(self.candidates), "structure"), label)

    @property
    def brief(self) -> str:
        """The verdict, and the structures with the least BIC."""
        # NaN, of a structure without a fit, comes last.
        order = sorted(range(len(self.bic)), key=lambda k: (math.isnan(self.bic[k]), self.bic[k]))
        best = order[:BRIEF]
        lines = [self.verdict, "", *self._table(best)]
        if rest := len(order) - len(best):
            others = counted(rest, "other structure was", "other structures were")
            lines.append(f"{others} fitted.")
        return "\n".join(lines)

    def __str__(self) -> str:
        header, rule, *rows = self._table(range(len(self.candidates)))
        lines = [header, rule]
        for candidate, row in zip(self.candidates, rows, strict=True):
            # What a structure describes is too long for a column.
            lines += [row, f"    {candidate.about}"] if candidate.about else [row]
        if self.note:
            lines.append(self.note)
        return folded("\n".join([*lines, "", self.verdict]))

    def _table(self, places: Iterable[int]) -> list[str]:
        """Return the lines of the table of the candidates at these places."""
        least = min((value for value in self.bic if not math.isnan(value)), default=math.nan)
        rows = []
        for k in places:
            candidate = self.candidates[k]
            fit = candidate.fit
            chosen = ["chosen"] if candidate is self.chosen else []
            rows.append(
                [
                    candidate.label,
                    str(len(fit.free)),
                    number(fit.cost, 4) if fit.converged else "no fit",
                    number(round(self.bic[k] - least, 2), 4),
                    number(candidate.noise, 3),
                    "; ".join([*chosen, *candidate.remarks]),
                ]
            )
        header = ["structure", "free", "cost", "BIC above", "residual/noise", "remark"]
        return text_table(header, rows, left=(0, 5)).split("\n")


def select(candidates: Sequence[Candidate], note: str = "") -> Selection:
    """Choose the smallest structure that the data support, by BIC.

    Where even the closest structure leaves residuals larger than the given variances, costs are
    divided by the factor (quasi-likelihood): otherwise errors that no structure describes would
    support ever more parameters. Source: Burnham and Anderson (2002), section 2.5.
    A structure with an unstable pole is chosen only where its BIC is lower by 6.
    """
    fitted = [c for c in candidates if c.fit.converged]
    if not fitted:
        return Selection(tuple(candidates), None, (math.nan,) * len(candidates), NO_FIT, note)
    # Where variances are unknown, NaN becomes zero, which means no inflation: the scale of those
    # likelihoods is estimated.
    inflation = max(1.0, np.nan_to_num(min(c.noise for c in fitted)) ** 2)
    numbers = sum(part.compared_numbers for part in fitted[0].fit.parts)
    bic = []
    for candidate in candidates:
        if not candidate.fit.converged:
            bic.append(math.nan)
            continue
        penalty = PENALTY_OF_UNSTABLE if candidate.unstable else 0.0
        unknowns = count_unknowns(candidate.fit)
        value = 2 * candidate.fit.cost / inflation + unknowns * math.log(numbers) + penalty
        bic.append(value)
    finite = [value for value in bic if not math.isnan(value)]
    k, reason = parsimony([c.label for c in fitted], finite, [len(c.fit.free) for c in fitted])
    return Selection(tuple(candidates), fitted[k], tuple(bic), reason, note)


def held_by_bounds(fit: Fit) -> tuple[str, ...]:
    """Return the remark that parameters ended at a bound."""
    names = fit.at_bound
    if not names:
        return ()
    return (f"{listed(names)} at {'its' if len(names) == 1 else 'their'} bound",)
