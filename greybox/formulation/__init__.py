"""What is estimated from what, by which rule.

Begin with `problem`: a model, data and a criterion, with fixed, free, tied and renamed parameters;
problems add to a `sum`, which asks of each part what stands in `summand`: `added_criteria` sees to
it that their costs add, and `data_used_twice` that none of their data are there twice. What all
rules share is in `criterion`, the rules themselves in `frequency_criteria`, `time_criteria` and
`spectrum_criteria` (of manoeuvres), the list of them in `included_criteria`; `relative_score` knows
what noise makes of the relative ones. `several` states one problem for several records,
`sensor_biases` numbers the biases that each record has for itself, `held_estimate` is what a
problem asks of an earlier `Fit` whose values it holds fixed, `prior` what is known of parameters
before the data, `prior_part` that as a part of a sum, `restated_parameter` gives a parameter other
bounds and starts than its model declares, `input_assumptions` says how inputs run between their
samples, `signal_units` holds the units of a record against those that the model declares, and
`starts` are the points from which a search begins, one rule a class.
"""

from greybox.formulation.frequency_criteria import Criterion as Criterion
from greybox.formulation.frequency_criteria import MagnitudePhase as MagnitudePhase
from greybox.formulation.frequency_criteria import MaximumLikelihood as MaximumLikelihood
from greybox.formulation.frequency_criteria import RelativeError as RelativeError
from greybox.formulation.frequency_criteria import RelativeLikelihood as RelativeLikelihood
from greybox.formulation.frequency_criteria import SquaredRelativeError as SquaredRelativeError
from greybox.formulation.problem import Problem as Problem
from greybox.formulation.several import several as several
from greybox.formulation.spectrum_criteria import EquationError as EquationError
from greybox.formulation.starts import Starts as Starts
from greybox.formulation.sum import Sum as Sum
from greybox.formulation.time_criteria import OutputError as OutputError
from greybox.formulation.time_criteria import PredictionError as PredictionError
from greybox.formulation.time_criteria import TimeCriterion as TimeCriterion
