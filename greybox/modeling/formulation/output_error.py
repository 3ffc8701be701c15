"""Output error: the model is simulated, and all errors are in the measured outputs."""

from typing import Any, Literal

from greybox.data.files.frozen_values import frozen
from greybox.data.files.normalization import normalize
from greybox.data.files.public import public
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.modeling.formulation.time_criterion import TimeCriterion
from greybox.statistics.error_distribution import ErrorDistribution
from greybox.statistics.included_errors import ERRORS

ROWS_CONDITION = "independent errors of equal variance in each output"
SPECTRUM_CONDITION = (
    "errors of the outputs whose size changes slowly over the band, as in light turbulence, and "
    "known inputs"
)


@public
@frozen
class OutputError(TimeCriterion):
    """Maximum likelihood with all errors in the measured outputs; the model is simulated.

    For a `TransientSpectrum` it compares the transforms and estimates the states at both ends;
    `inputs`, `biases` and `initial` are for records.

    Outputs at the beginning of a record that depend on a delayed input from before it are left out,
    unless that input is at rest there, see `TimeCriterion`.

    Parameters
    ----------
    errors : "normal", "huber" or ErrorDistribution
        How the errors are distributed, see `gb.formulation.ErrorDistribution` for one of your own.
        With "huber", errors beyond 1.345 standard deviations count as 1.345, so that outliers of a
        sensor do not decide the estimate; the standard deviation follows from the median. Standard
        errors are those of this M-estimator, with 5 % more variance for normal errors. The cost is
        that of the record with its outliers moved to this bound. Only for records.

    Examples
    --------
    >>> from greybox.models.specific_force import BodyDrag
    >>> from greybox.problems import nanobench_drag
    >>> record = nanobench_drag.data()[0]
    >>> offsets = gb.OutputError(biases=("a_x", "a_y"))  # constant errors of the sensors
    >>> fit = gb.fit(gb.Problem(BodyDrag(), record, criterion=offsets), starts=1)
    >>> fit.converged
    True
    """

    errors: Literal["normal", "huber"] | ErrorDistribution = "normal"
    rule = "output error"

    def __post_init__(self) -> None:
        """Check the options."""
        super().__post_init__()
        if isinstance(self.errors, ErrorDistribution):
            # An included one has its name, so that both statements are equal and can be stored.
            names = [name for name, included in ERRORS.items() if included == self.errors]
            normalize(self, errors=names[0] if names else self.errors)
        elif self.errors not in [*ERRORS]:
            raise ValueError(
                f"errors is {self.errors!r}: give 'normal', 'huber' or an ErrorDistribution."
            )

    @property
    def error_distribution(self) -> ErrorDistribution:
        """How the errors of the outputs are distributed."""
        return ERRORS[self.errors] if isinstance(self.errors, str) else self.errors

    @property
    def description(self) -> str:
        """The rule in words."""
        words = self.error_distribution.description
        return f"{super().description}, {words}" if words else super().description

    def condition_on(self, data: Any) -> str:
        """Return the condition; errors of rows without a time cannot be correlated."""
        if isinstance(data, TransientSpectrum):
            return SPECTRUM_CONDITION
        return self.condition if data.has_time else ROWS_CONDITION
