"""Linear systems whose numbers are known, such as a filter or an actuator, as models.

The coefficients of a transfer function are fixed parameters: a problem may free one of them,
``free=["a1"]``.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.files.arrays import all_finite
from greybox.modeling.function_of_s import polynomial_value
from greybox.modeling.parameter import Parameter
from greybox.modeling.state_space import StateSpace
from greybox.modeling.transfer_function import TransferFunction


class KnownTransferFunction(TransferFunction):
    r"""Ratio of two polynomials with given coefficients.

    $$\frac{b_m s^m + \dots + b_0}{a_n s^n + \dots + a_0}$$

    Parameters
    ----------
    numerator, denominator : sequence of float
        Highest power of s first.
    input, output : str
        Names of the signals.
    prefix : str
        Begins the names of the coefficients, ``<prefix>b0`` and so on: where two such models are
        connected, each needs one of its own.

    Raises
    ------
    ValueError
        For coefficients that are not finite, or a denominator that is zero.
    """

    def __init__(
        self,
        numerator: Sequence[float],
        denominator: Sequence[float],
        input: str = "u",
        output: str = "y",
        prefix: str = "",
    ) -> None:
        b = _coefficients(numerator, "numerator")
        a = _coefficients(denominator, "denominator")
        if a == [0.0]:
            raise ValueError("the denominator is zero: give one with a coefficient that is not.")

        # Plain lists, which a stored result can contain.
        self.arguments = ((b, a, input, output, prefix), {})
        self.input = input
        self.output = output
        self.parameters = {
            f"{prefix}{letter}{power}": Parameter(value, fixed=True, about=f"of s^{power}")
            for letter, values in (("b", b), ("a", a))
            for power, value in zip(reversed(range(len(values))), values, strict=True)
        }

    def response(self, s: Any, p: Any) -> Any:
        """Return the ratio."""
        coefficients = [p[name] for name in self.parameters]
        count = len(self.arguments[0][0])
        return polynomial_value(coefficients[:count], s) / polynomial_value(coefficients[count:], s)


class KnownStateSpace(StateSpace):
    """``x' = A x + B u``, ``y = C x + D u`` with given matrices, and without parameters.

    Parameters
    ----------
    A, B, C, D : arrays (n, n), (n, m), (k, n), (k, m)
    states, inputs, outputs : sequence of str
        By default ``x1, x2 ...``, ``u`` or ``u1, u2 ...`` and ``y`` or ``y1, y2 ...``.

    Raises
    ------
    ValueError
        For matrices that do not fit together, numbers that are not finite, or another number of
        names.
    """

    def __init__(
        self,
        A: ArrayLike,
        B: ArrayLike,
        C: ArrayLike,
        D: ArrayLike,
        *,
        states: Sequence[str] = (),
        inputs: Sequence[str] = (),
        outputs: Sequence[str] = (),
    ) -> None:
        matrices = [np.atleast_2d(np.array(value, dtype=float)) for value in (A, B, C, D)]
        k, m = matrices[3].shape
        n = matrices[0].shape[0] if matrices[0].size else 0
        arrays = []
        shapes = ((n, n), (n, m), (k, n), (k, m))
        for name, value, shape in zip("ABCD", matrices, shapes, strict=True):
            matrix = value.reshape(shape) if value.size == n == 0 else value
            if matrix.shape != shape:
                raise ValueError(f"{name} has shape {matrix.shape} where the others need {shape}.")
            if not all_finite(matrix):
                raise ValueError(f"{name} has an entry that is not finite: give finite numbers.")
            arrays.append(matrix)

        self.states = _signal_names(states, "x", n, numbered=True)
        self.inputs = _signal_names(inputs, "u", m)
        self.outputs = _signal_names(outputs, "y", k)
        names = {"states": self.states, "inputs": self.inputs, "outputs": self.outputs}
        self.arguments = (tuple(array.tolist() for array in arrays), names)
        self._rows = np.block([arrays[:2], arrays[2:]]).tolist()

    def derivative(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return A x + B u."""
        return self._products(self._rows[: len(self.states)], x, u)

    def output(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return C x + D u."""
        return self._products(self._rows[len(self.states) :], x, u)

    def _products(self, rows: list[list[float]], x: Any, u: Any) -> list[Any]:
        signals = [*(x[name] for name in self.states), *(u[name] for name in self.inputs)]
        # Zeros are left out: the graph of a large system stays as sparse as its matrices.
        return [sum((c * v for c, v in zip(row, signals, strict=True) if c), 0.0) for row in rows]


def _coefficients(values: Sequence[float], what: str) -> list[float]:
    """Return the coefficients without leading zeros."""
    numbers = np.atleast_1d(np.array(values, dtype=float))
    if numbers.ndim != 1 or not numbers.size or not all_finite(numbers):
        raise ValueError(
            f"the {what} is {values!r:.60}: give finite coefficients, highest power of s first."
        )
    return np.trim_zeros(numbers, "f").tolist() or [0.0]


def _signal_names(
    names: Sequence[str], letter: str, count: int, *, numbered: bool = False
) -> tuple[str, ...]:
    if not names:
        is_alone = count == 1 and not numbered
        return (letter,) if is_alone else tuple(f"{letter}{k + 1}" for k in range(count))
    if isinstance(names, str) or len(names) != count:
        raise ValueError(f"{names!r:.60} are the names of {count} signals: give as many.")

    return tuple(names)
