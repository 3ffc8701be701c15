"""Fits held against each other and against data that they have not seen.

Begin with `compare`; `significance` decides which of two models predicts better.
"""

from greybox.validation.compare import compare as compare
from greybox.validation.compare import nested_test as nested_test
from greybox.validation.comparison import Comparison as Comparison
from greybox.validation.comparison import NestedTest as NestedTest
