"""The included criteria, for the command line and for the table of costs of a result."""

from greybox.modeling.formulation.frequency_criteria import (
    Criterion,
    MagnitudePhase,
    MaximumLikelihood,
    RelativeError,
    RelativeLikelihood,
    SquaredRelativeError,
)
from greybox.modeling.formulation.output_error import OutputError
from greybox.modeling.formulation.prediction_error import PredictionError
from greybox.modeling.formulation.spectrum_criteria import EquationError
from greybox.modeling.formulation.time_criterion import TimeCriterion

CRITERIA: tuple[Criterion, ...] = (
    RelativeError(),
    RelativeError(normalized="model"),
    SquaredRelativeError(),
    RelativeLikelihood(),
    MagnitudePhase(),
    MaximumLikelihood(),
)
"""For frequency responses; a result reports the cost by each of them."""

TIME_CRITERIA: tuple[TimeCriterion, ...] = (OutputError(), PredictionError())
"""For records."""

SPECTRUM_CRITERIA: tuple[TimeCriterion, ...] = (OutputError(), EquationError())
"""For the Fourier integrals of manoeuvres."""
