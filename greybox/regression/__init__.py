"""Estimates by linear least squares, which need no start.

`levy` fits the coefficients of a transfer function, (3.17), and chooses its orders; `equation_error` fits differential
equations to smoothed derivatives.
"""

from greybox.regression.equation_error import EquationError as EquationError
from greybox.regression.equation_error import equation_error as equation_error
from greybox.regression.levy import levy as levy
from greybox.regression.levy import order_path as order_path
