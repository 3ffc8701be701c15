"""Fits compared with each other and with data that they have not seen.

Begin with `compare`.

| file | contents |
| --- | --- |
| `compare` | fits side by side, on their own data and on records that none has seen |
| `comparison` | the result: a table and sentences that print themselves |
| `same_data` | whether fits have the same data and comparable costs |
| `measures` | the rows of the table, and one likelihood for fits by different criteria |
| `significance` | the sentences: which of two models is closer to the data |
| `parsimony` | the smallest structure that the data support |
| `nesting`, `nested_models` | whether one fit contains another; the test of its further terms |
| `joint_test` | whether several parameters of one fit are needed together |
| `held_out` | predictions of the same windows by all fits |
| `stepwise` | terms chosen from a list of candidates |
| `differences` | which parameters differ between fits to different data |
"""

from greybox.assessment.validation.compare import compare as compare
from greybox.assessment.validation.comparison import Comparison as Comparison
from greybox.assessment.validation.differences import (
    Differences as Differences,
    differences as differences,
)
from greybox.assessment.validation.joint_test import (
    JointTest as JointTest,
    joint_test as joint_test,
)
from greybox.assessment.validation.nested_models import (
    NestedTest as NestedTest,
    nested_test as nested_test,
)
from greybox.assessment.validation.stepwise import (
    StepwiseSelection as StepwiseSelection,
    stepwise as stepwise,
)
