"""What is estimated from what, by which criterion.

Begin with `problem`.

| file | contents |
| --- | --- |
| `problem` | a model, data and a criterion, with fixed, free, tied and renamed parameters |
| `several`, `several_responses` | one model for several records, or the responses of many pairs |
| `data_kind`, `data_kinds` | what a problem asks of its data, and the kinds that answer |
| `response_kind`, `record_kind`, `spectrum_kind` | the kinds of data, one each |
| `unsupported_data` | what a problem cannot take as data, and the cure |
| `resolved_parameters` | what of the parameters is free, fixed, tied and renamed |
| `restated_parameter` | a parameter with other bounds or starts |
| `parameter_formulas` | ties, constraints and derived quantities, tried before a search |
| `sum` | `Sum`: problems solved at once, whose costs add; each record has its own biases |
| `criterion` | what all criteria share |
| `frequency_criteria` | the criteria for frequency responses |
| `error_covariance` | how accurate outputs are: estimated, or known |
| `time_criterion` | what the criteria for records share |
| `output_error`, `prediction_error` | the criteria for records |
| `spectrum_criteria` | the criterion for spectra of manoeuvres alone |
| `modeled_outputs` | which outputs of a model the data have |
| `input_assumptions` | how inputs vary between samples, and who says it |
| `included_criteria` | the list of them |
| `signal_bias` | the constant error of a measured signal, as a parameter |
| `relative_score` | bias and spread of relative criteria by noise |
| `prior`, `prior_part` | a-priori knowledge, and a sum with it |
| `held_estimate` | an earlier fit whose values a problem holds fixed |
| `signal_units` | units of data against those of the model |
| `starts` | where the runs of a search begin |
"""

from greybox.modeling.disturbance import Disturbance as Disturbance
from greybox.modeling.formulation.error_covariance import ErrorCovariance as ErrorCovariance
from greybox.modeling.formulation.frequency_criteria import (
    Criterion as Criterion,
    MagnitudePhase as MagnitudePhase,
    MaximumLikelihood as MaximumLikelihood,
    RelativeError as RelativeError,
    RelativeLikelihood as RelativeLikelihood,
    SquaredRelativeError as SquaredRelativeError,
)
from greybox.modeling.formulation.output_error import OutputError as OutputError
from greybox.modeling.formulation.prediction_error import PredictionError as PredictionError
from greybox.modeling.formulation.problem import Problem as Problem
from greybox.modeling.formulation.several import several as several
from greybox.modeling.formulation.spectrum_criteria import EquationError as EquationError
from greybox.modeling.formulation.starts import Starts as Starts
from greybox.modeling.formulation.sum import Sum as Sum
from greybox.modeling.formulation.time_criterion import TimeCriterion as TimeCriterion
from greybox.statistics.error_distribution import ErrorDistribution as ErrorDistribution
