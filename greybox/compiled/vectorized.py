"""A CasADi function evaluated in numpy for many columns at once: one ufunc call per operation.

CasADi's own interpreter takes about 1.5 to 4 ns per operation and column; over some thousand
columns a ufunc takes a fifth of that. Operations on inputs that all columns share (the parameters)
are done once.
"""

import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from greybox.files.arrays import Array
from greybox.modeling.one_thread import cached_property, one_thread_at_a_time

CHUNK = 4096  # columns at once: so many fit into the cache


def _if_else_zero(condition: Array, value: Array, out: Array) -> None:
    np.copyto(out, np.where(condition, value, 0.0))


def _assign(value: Array, out: Array) -> None:
    np.copyto(out, value)


def _twice(value: Array, out: Array) -> None:
    np.add(value, value, out)


_OPERATIONS: dict[int, Callable[..., Any]] = {
    ca.OP_ASSIGN: _assign,
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_NEG: np.negative,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: _twice,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_ASINH: np.arcsinh,
    ca.OP_ACOSH: np.arccosh,
    ca.OP_ATANH: np.arctanh,
    ca.OP_LT: np.less,
    ca.OP_LE: np.less_equal,
    ca.OP_EQ: np.equal,
    ca.OP_NE: np.not_equal,
    ca.OP_NOT: np.logical_not,
    ca.OP_AND: np.logical_and,
    ca.OP_OR: np.logical_or,
    ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil,
    ca.OP_FMOD: np.fmod,
    ca.OP_FABS: np.fabs,
    ca.OP_SIGN: np.sign,
    ca.OP_COPYSIGN: np.copysign,
    ca.OP_IF_ELSE_ZERO: _if_else_zero,
    ca.OP_FMIN: np.fmin,
    ca.OP_FMAX: np.fmax,
    ca.OP_INV: np.reciprocal,
    ca.OP_HYPOT: np.hypot,
    ca.OP_LOG1P: np.log1p,
    ca.OP_EXPM1: np.expm1,
}


class Columns:
    """A function of dense inputs, evaluated for many columns; `shared` inputs (by position) are the same in all.

    CasADi evaluates fewer columns than `fewest`, since the layout of registers for another number of
    columns takes some milliseconds, and functions that are not SX or contain an operation without a
    ufunc.
    """

    def __init__(
        self, function: ca.Function, shared: tuple[int, ...] = (), fewest: int = 1
    ) -> None:
        function = _dense(function)
        self._function, self._shared, self._fewest = function, shared, fewest
        self._sizes = [function.numel_out(k) for k in range(function.n_out())]
        self._bound: dict[int, _Bound] = {}
        self._mapped: dict[int, _Mapped] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what builds the same evaluation: the memory that CasADi writes to cannot be pickled."""
        return Columns, (self._function, self._shared, self._fewest)

    @cached_property
    def _program(self) -> list[tuple[int, list[int], list[int], float]] | None:
        return _read(self._function) if self._function.is_a("SXFunction") else None

    def __call__(self, *inputs: Array) -> list[Array]:
        """Return the outputs, (numel, m) each, for inputs (numel, m), shared ones (numel,)."""
        m = next(v.shape[1] for k, v in enumerate(inputs) if k not in self._shared)
        outputs = [np.empty((size, m)) for size in self._sizes]
        # In equal shares, so that all need one layout of the registers.
        size = math.ceil(m / math.ceil(m / CHUNK)) if m else 1
        for begin in range(0, m, size):
            columns = slice(begin, min(begin + size, m))
            part = [v if k in self._shared else v[:, columns] for k, v in enumerate(inputs)]
            count = columns.stop - begin
            # A ufunc takes 0.2 µs whatever the number of columns, CasADi's operation 1.6 ns for each.
            if count < self._fewest or count <= 128 or self._program is None:
                for out, value in zip(outputs, self._evaluated(part, count), strict=True):
                    out[:, columns] = value
            else:
                layout = self._bound.get(count) or self._bind(count)
                layout.run(part, [out[:, columns] for out in outputs])
        return outputs

    def _evaluated(self, inputs: list[Array], m: int) -> list[Array]:
        if m not in self._mapped:
            if len(self._mapped) > 12:
                self._mapped.clear()
            self._mapped[m] = _Mapped(self._function, self._shared, m)
        return self._mapped[m].run(inputs)

    def _bind(self, m: int) -> "_Bound":
        if len(self._bound) > 12:
            self._bound.clear()
        self._bound[m] = _Bound(self._program or [], self._function, self._shared, m)
        return self._bound[m]


@one_thread_at_a_time
def _dense(function: ca.Function) -> ca.Function:
    """Return the function with dense inputs and outputs."""
    is_dense = all(function.nnz_in(k) == function.numel_in(k) for k in range(function.n_in()))
    if is_dense and all(
        function.nnz_out(k) == function.numel_out(k) for k in range(function.n_out())
    ):
        return function
    kind: Any = ca.SX if function.is_a("SXFunction") else ca.MX
    inputs = [kind.sym("v", *function.size_in(k)) for k in range(function.n_in())]
    return ca.Function(
        function.name(), inputs, [ca.densify(value) for value in function.call(inputs)]
    )


class _Mapped:
    """A function of dense inputs and outputs mapped over m columns, with its own memory for both."""

    @one_thread_at_a_time
    def __init__(self, function: ca.Function, shared: tuple[int, ...], m: int) -> None:
        mapped = function if m == 1 else function.map("columns", "serial", m, list(shared), [])
        buffer: Any
        buffer, self._call = mapped.buffer()
        # CasADi's columns are rows here.
        self._inputs = [np.empty(function.numel_in(k) if k in shared else (m, function.numel_in(k)))
                        for k in range(function.n_in())]  # fmt: skip
        self._outputs = [np.empty((m, function.numel_out(k))) for k in range(function.n_out())]
        for k, value in enumerate(self._inputs):
            buffer.set_arg(k, value.data)
        for k, value in enumerate(self._outputs):
            buffer.set_res(k, value.data)
        self._references = mapped, buffer  # CasADi does not keep them alive

    def run(self, inputs: list[Array]) -> list[Array]:
        """Return the outputs, (numel, m) each, in memory that the next call overwrites."""
        for memory, value in zip(self._inputs, inputs, strict=True):
            memory[...] = value.T
        self._call()
        return [value.T for value in self._outputs]


def _read(function: ca.Function) -> list[tuple[int, list[int], list[int], float]] | None:
    """Return operation, inputs, outputs and constant of every instruction; None if one has no ufunc."""
    program = []
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        if operation not in _OPERATIONS and operation not in _READING:
            return None
        value = function.instruction_constant(k) if operation == ca.OP_CONST else 0.0
        program.append(
            (operation, function.instruction_input(k), function.instruction_output(k), value)
        )
    return program


class _Bound:
    """A program with its registers laid out for m columns."""

    def __init__(
        self, program: list[Any], function: ca.Function, shared: tuple[int, ...], m: int
    ) -> None:
        self._reads: list[tuple[int, int, Array]] = []
        self._writes: list[tuple[int, int, Array]] = []
        self._calls: list[tuple[Callable[..., Any], tuple[Array, ...]]] = []
        wide: dict[int, Array] = {}
        flags: dict[int, Any] = {}
        narrow: dict[int, Array] = {}
        now: dict[int, Array] = {}
        for operation, sources, targets, constant in program:
            if operation == ca.OP_OUTPUT:
                # A copy, because the register may be used again.
                copy = np.empty(m)
                self._calls.append((_assign, (now[sources[0]], copy)))
                self._writes.append((targets[0], targets[1], copy))
                continue
            target = targets[0]
            if operation == ca.OP_CONST:
                now[target] = np.array(constant)
                continue
            if operation == ca.OP_INPUT:
                value = np.empty(()) if sources[0] in shared else np.empty(m)
                self._reads.append((sources[0], sources[1], value))
                now[target] = value
                continue
            arguments = tuple(now[source] for source in sources[: _arity(operation)])
            if operation not in _TAKING_FLAGS:
                arguments = tuple(self._number(argument) for argument in arguments)
            if all(a.ndim == 0 for a in arguments):
                # A register of its own, because the result may be read much later.
                out = narrow.setdefault(len(narrow), np.empty(()))
            elif operation in _GIVING_FLAGS:
                out = flags.setdefault(target, np.empty(m, bool))
            else:
                out = wide.setdefault(target, np.empty(m))
            self._calls.append((_OPERATIONS[operation], (*arguments, out)))
            now[target] = out

    def _number(self, value: Array) -> Array:
        """Return flags as numbers."""
        if value.dtype != bool:
            return value
        number = np.empty(value.shape)
        self._calls.append((_assign, (value, number)))
        return number

    def run(self, inputs: list[Array], outputs: list[Array]) -> None:
        """Evaluate into `outputs`."""
        for source, row, register in self._reads:
            register[...] = inputs[source][row]
        with np.errstate(all="ignore"):
            for call, arguments in self._calls:
                call(*arguments)
        for target, row, register in self._writes:
            outputs[target][row] = register


def _arity(operation: int) -> int:
    return 2 if operation in _BINARY else 1


_BINARY = {
    ca.OP_ADD,
    ca.OP_SUB,
    ca.OP_MUL,
    ca.OP_DIV,
    ca.OP_POW,
    ca.OP_CONSTPOW,
    ca.OP_ATAN2,
    ca.OP_LT,
    ca.OP_LE,
    ca.OP_EQ,
    ca.OP_NE,
    ca.OP_AND,
    ca.OP_OR,
    ca.OP_FMOD,
    ca.OP_COPYSIGN,
    ca.OP_IF_ELSE_ZERO,
    ca.OP_FMIN,
    ca.OP_FMAX,
    ca.OP_HYPOT,
}

_READING = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER}

# Comparisons return boolean arrays: as numbers, they take three times as long for many columns.
_GIVING_FLAGS = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR}
_TAKING_FLAGS = {ca.OP_NOT, ca.OP_AND, ca.OP_OR, ca.OP_IF_ELSE_ZERO}
