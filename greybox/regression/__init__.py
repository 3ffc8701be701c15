"""Estimates by linear least squares: they need no compiled problem, and no start.

Begin with `levy`, which fits the coefficients of a transfer function, (3.17); `order_selection`
chooses its orders by `poles_and_zeros` that nearly cancel. Or begin with `equation_error`, which
fits differential equations to smoothed derivatives: `linear_in_parameters` splits the equations
into terms, `smoothing` filters the signals, `regressors` evaluates the terms along the record,
`least_squares` solves for the parameters that enter linearly, and `variable_projection` searches
the others.
"""

from greybox.regression.equation_error import EquationErrorEstimate as EquationErrorEstimate
from greybox.regression.equation_error import equation_error as equation_error
from greybox.regression.levy import levy as levy
from greybox.regression.order_selection import order_path as order_path
