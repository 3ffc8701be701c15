"""Fits held against each other and against data that they have not seen.

Begin with `compare`, which fills a `comparison` (table and sentences that print themselves). `same_data` tells whether
fits have the same data and comparable costs, `same_windows` predicts the same windows by all of them, and
`significance` tests which of two models is closer to the data and which terms the data determine.
"""

from greybox.validation.compare import compare as compare
from greybox.validation.compare import nested_test as nested_test
from greybox.validation.comparison import Comparison as Comparison
from greybox.validation.comparison import NestedTest as NestedTest
