"""What the checks of a fit may look at."""

from functools import cached_property

from greybox.assessment.fitted_part import FittedRecord
from greybox.assessment.result import Fit
from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.public import public
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.covariance.accuracy import Accuracy
from greybox.engine.solve.search import Search

Pairs = list[tuple[RecordPart, FittedRecord]]


@public
@frozen
class Evidence:
    """A search, its best minimum, and the estimate there.

    Attributes
    ----------
    search : Search
        All runs and minima, and the solver with the compiled problem.
    accuracy : Accuracy
        The covariance, what it consists of, and what the data leave open.
    fit : Fit
        The answer: values, errors, residuals, and the misfit once that is known.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> def few_points(evidence):
    ...     for part in evidence.fit.responses:
    ...         if len(part.data) < 20:
    ...             yield gb.Finding(f"{part.name!r} has {len(part.data)} points.", is_note=True)
    >>> fit = gb.fit(pitch_hover.problem(), starts=5, checks=[few_points])
    >>> len(fit.notes) > 0
    True
    """

    search: Search
    accuracy: Accuracy
    fit: Fit

    @property
    def nlp(self) -> CompiledProblem:
        """The compiled problem."""
        return self.accuracy.nlp

    @property
    def x(self) -> Array:
        """The estimate (p,)."""
        return self.accuracy.x

    @property
    def is_explained(self) -> bool:
        """False if the test of misfit shows that the model does not explain the data."""
        return self.fit.is_explained

    @property
    def is_exact(self) -> bool:
        """Whether rounding is all that the residuals are."""
        return bool(self.fit.misfit and self.fit.misfit.is_exact)

    @property
    def has_errors(self) -> bool:
        """Whether residuals are errors: those of a wrong model are not, nor is rounding."""
        return self.is_explained and not self.is_exact

    @property
    def is_noisy(self) -> bool:
        """Whether noise is a part of the residuals, even if a misfit is another one.

        Disturbances under feedback may look like missing terms, which leave a part of the misfit.
        """
        return not self.is_exact and not (self.fit.misfit and self.fit.misfit.is_large)

    def trajectory(self, part: RecordPart) -> Trajectory:
        """Return the trajectory of a compiled record at the estimate."""
        rows = zip(self.nlp.parts, self.accuracy.trajectories, strict=True)
        return next(trajectory for other, trajectory in rows if other is part)

    @cached_property
    def records(self) -> Pairs:
        """Every record as it was compiled, and with the values at the estimate."""
        return [*self.nlp.rows_of(RecordPart, self.fit.parts)]
