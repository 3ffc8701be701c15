"""What is estimated from what, by which rule.

Begin with `problem` (model + data + criterion). `frequency_criteria` and `time_criteria` hold the rules, `starts` the
points from which a search begins, `held_estimate` what an earlier `Fit` gives to a problem that holds its values.
"""

from greybox.formulation.frequency_criteria import Criterion as Criterion
from greybox.formulation.frequency_criteria import MagnitudePhase as MagnitudePhase
from greybox.formulation.frequency_criteria import MaximumLikelihood as MaximumLikelihood
from greybox.formulation.frequency_criteria import RelativeError as RelativeError
from greybox.formulation.frequency_criteria import SquaredRelativeError as SquaredRelativeError
from greybox.formulation.problem import Problem as Problem
from greybox.formulation.problem import Sum as Sum
from greybox.formulation.several import several as several
from greybox.formulation.starts import Starts as Starts
from greybox.formulation.time_criteria import OutputError as OutputError
from greybox.formulation.time_criteria import PredictionError as PredictionError
from greybox.formulation.time_criteria import TimeCriterion as TimeCriterion
