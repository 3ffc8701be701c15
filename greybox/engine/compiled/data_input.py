"""The data of frequency responses as an input of compiled functions.

Problems that differ only in their data share the functions, with all that solvers build from them.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, real_and_imaginary
from greybox.data.files.named_values import selected
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.response_columns import EXTRAS
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.formulation.frequency_criteria import Criterion
from greybox.modeling.formulation.included_criteria import CRITERIA
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.symbolic_reading import traced


class _Measured(Complex):
    """A measured response as symbols, with `np.abs`, which criteria use on data."""

    def __init__(self, re: Any, im: Any, magnitude: Any) -> None:
        super().__init__(re, im)
        self._magnitude = magnitude

    def __abs__(self) -> Any:
        return self._magnitude

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any) -> Any:
        return abs(self) if ufunc is np.absolute else NotImplemented


INCLUDED = {type(criterion) for criterion in CRITERIA}


def columns_of(data: FrequencyResponse) -> Mapping[str, Array]:
    """Return the columns, besides the response, on which a cost may depend."""
    return selected(data.columns, EXTRAS)


def data_numbers(data: FrequencyResponse, response: ComplexArray) -> Array:
    """Return the numbers of data with another measured `response` (n,), one column after another.

    These are real parts, imaginary parts, magnitudes, and the columns that the data have.
    """
    columns = [response.real, response.imag, np.abs(response), *columns_of(data).values()]
    return np.concatenate(columns)


def _with_symbols(data: FrequencyResponse, symbols: Any) -> FrequencyResponse:
    """Return the data with symbols in place of their numbers."""
    re, im, magnitude, *others = ca.vertsplit(symbols, len(data))
    opened = copy(data)  # a new one would check its values, which are symbols
    vars(opened).update(
        response=_Measured(re, im, magnitude), **dict(zip(columns_of(data), others, strict=True))
    )
    return opened


class DataInput:
    """The constants and the data of all responses of a problem as one input.

    Attributes
    ----------
    are_open : list of bool
        Whether the data of a part are in the input: its criterion may accept only numbers.
    numbers : (g,) array
        The constants (c,), then the data of one part after the other.
    """

    def __init__(self, constants: Array, parts: Sequence[Problem]) -> None:
        self._data = [part.response for part in parts]
        self.are_open = [_takes_symbols(part) for part in parts]
        pieces = [
            data_numbers(data, data.response) if is_open else np.zeros(0)
            for data, is_open in zip(self._data, self.are_open, strict=True)
        ]
        self.numbers = np.concatenate([constants, *pieces])
        self._ends = np.cumsum([0, len(constants), *map(len, pieces)]).tolist()

    def at(self, symbols: Any) -> tuple[list[Any], list[FrequencyResponse]]:
        """Return constants and data at symbols (g,) of the input."""
        constants, *pieces = ca.vertsplit(symbols, self._ends)
        columns = zip(self._data, self.are_open, pieces, strict=True)
        data = [
            _with_symbols(response, piece) if is_open else response
            for response, is_open, piece in columns
        ]
        return ca.vertsplit(constants), data


def _takes_symbols(part: Problem) -> bool:
    """Return whether the cost of a part can be compiled with the data as symbols.

    A user's criterion may call numpy functions that take only numbers, or branch on the numbers.
    """
    criterion, data = part.criterion, part.response
    assert isinstance(criterion, Criterion)
    if type(criterion) in INCLUDED:
        return True
    numbers = data_numbers(data, data.response)
    symbols, r = ca.SX.sym("data", len(numbers)), ca.SX.sym("r", 2 * len(data))
    re, im = ca.vertsplit(r, len(data))
    elsewhere = (1.1 + 0.1j) * data.response
    try:
        costs = [
            traced("cost", criterion.cost, Complex(re, im), each)
            for each in (_with_symbols(data, symbols), data)
        ]
        function = ca.Function("costs", [r, symbols], [*map(ca.SX, costs)])
        opened, plain = function(real_and_imaginary(elsewhere), numbers)
        return bool(np.isclose(float(opened), float(plain), rtol=1e-9))
    except (ValueError, AttributeError):
        return False
