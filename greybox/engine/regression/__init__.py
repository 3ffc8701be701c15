"""Estimates by linear least squares, which need no start.

Begin with `equation_error` for records and `levy` for frequency responses.

| file | contents |
| --- | --- |
| `levy` | rational functions from responses, and the choice of their orders as in the paper |
| `poles_and_zeros` | how they are written, and pairs that nearly cancel |
| `equation_error` | parameters of an ODE from measured states |
| `linear_in_parameters` | which equations of a model become regressions |
| `smoothing` | smoothed signals and their derivatives |
| `regressors` | the regressions of a record |
| `least_squares` | the solution with bounds, and its covariance |
"""

from greybox.engine.regression.equation_error import (
    EquationErrorEstimate as EquationErrorEstimate,
    equation_error as equation_error,
)
from greybox.engine.regression.levy import levy as levy, order_path as order_path
