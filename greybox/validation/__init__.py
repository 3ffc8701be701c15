"""Fits held against each other and against data that they have not seen.

Begin with `compare`, which fills a `comparison` (table and sentences that print themselves).
`same_data` tells whether fits have the same data and comparable costs, `held_out` predicts the same
windows by all of them, on their own data and on records that none has seen, `measures` makes the
rows of the table, and `significance` the sentences: which of two models is closer to the data and
which terms the data determine. `nested_models` tests terms that one model has more than another,
and `nesting` shows that it is the other with terms removed. Fits of responses by different criteria
meet in a `common_likelihood`, `cross_validation` predicts what a fit was not given, and `parsimony`
names the smallest structure that the data support. `reduction` fits the smaller structure that a
fit suggests, and `stepwise` chooses terms from a list. `differences` tests which parameters of fits
to different data differ.
"""

from greybox.validation.compare import compare as compare
from greybox.validation.comparison import Comparison as Comparison
from greybox.validation.differences import Differences as Differences
from greybox.validation.differences import differences as differences
from greybox.validation.nested_models import NestedTest as NestedTest
from greybox.validation.nested_models import nested_test as nested_test
from greybox.validation.reduction import Reduction as Reduction
from greybox.validation.reduction import reduce as reduce
from greybox.validation.stepwise import StepwiseSelection as StepwiseSelection
from greybox.validation.stepwise import stepwise as stepwise
