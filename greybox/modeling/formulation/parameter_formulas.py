"""Formulas of parameters that a user gives: ties, constraints and derived quantities."""

import math
from collections.abc import Callable, Mapping
from numbers import Real
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.argument_checks import require_kind
from greybox.modeling.formula_arguments import Names
from greybox.modeling.model import ParameterFormula
from greybox.modeling.symbolic_reading import called, require_no_nan

Formulas = Mapping[str, ParameterFormula]
"""Formulas by what they are, such as ``constraints[0]``."""


def evaluated(formula: ParameterFormula, p: Names, what: str) -> Any:
    """Return the value of a formula; `what` names it where it fails."""
    cure = f"a function such as lambda p: 2 * p.{next(iter(p), 'a')}"
    require_kind(what, formula, Callable, cure)
    return called(what, formula, p)


def require_numbers(formulas: Formulas, values: Names) -> None:
    """Require that formulas give finite numbers; the message has the name of the formula.

    Raises
    ------
    TypeError, ValueError
        For what is no function, or gives no finite number.
    """
    for what, formula in formulas.items():
        _require_number(evaluated(formula, values, what), what)


def require_expressions(formulas: Formulas, symbols: Names) -> None:
    """Require that formulas give CasADi expressions of symbols.

    `if`, `max` and `math.exp` work with numbers, and would fail in the middle of a search.

    Raises
    ------
    TypeError, ValueError
        For formulas that do not.
    """
    for what, formula in formulas.items():
        require_no_nan(what, ca.SX(evaluated(formula, symbols, what)))


def _require_number(value: Any, what: str) -> None:
    # A comparison has no slope that a solver could follow.
    if isinstance(value, bool | np.bool_):
        raise ValueError(
            f"{what} gives True or False: write a difference that must be >= 0, such as p.T1 - "
            "p.T2."
        )
    if not isinstance(value, Real):
        raise ValueError(
            f"{what} gives {value!r:.60}: it must give an expression of the parameters."
        )

    if not math.isfinite(value):
        raise ValueError(
            f"{what} is {value} at the start values: correct the function or the starts."
        )
