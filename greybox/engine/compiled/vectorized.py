"""A CasADi function evaluated in numpy for many columns at once: one ufunc call per operation.

CasADi's own interpreter takes about 1.5 to 4 ns per operation and column; over some thousand
columns a ufunc takes a fifth of that. Operations on inputs that all columns share (the parameters)
are done once.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.rebuilt import Rebuilt
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.symbolic_reading import input_symbols

CHUNK = 4096  # columns at once: as many as fit into the cache
# Numbers of columns from which registers are faster than CasADi, for a function that is evaluated
# hundreds of times.
FEWEST = 129
# The same for one that is evaluated a few times: the layout takes 1.5 µs for every operation.
FEWEST_IN_A_FEW_CALLS = 512


# CasADi's operations by name. The ufuncs of the first have the same name.
_UFUNCS: dict[str, Callable[..., Any]] = {
    name: getattr(np, name.lower())
    for name in (
        *("ADD", "POW", "EXP", "LOG", "SQRT", "SIN", "COS", "TAN", "SINH", "COSH", "TANH", "HYPOT"),
        *("ASIN", "ACOS", "ATAN", "ATAN2", "ASINH", "ACOSH", "ATANH", "FLOOR", "CEIL", "FMOD"),
        *("SIGN", "COPYSIGN", "FMIN", "FMAX", "LOG1P", "EXPM1"),
    )
}
_UFUNCS |= {
    "ASSIGN": np.positive,
    "SUB": np.subtract,
    "MUL": np.multiply,
    "DIV": np.divide,
    "NEG": np.negative,
    "CONSTPOW": np.power,
    "SQ": np.square,
    "TWICE": np.add,
    "LT": np.less,
    "LE": np.less_equal,
    "EQ": np.equal,
    "NE": np.not_equal,
    "FABS": np.abs,  # ten times as fast as `np.fabs`
    "NOT": np.logical_not,
    "AND": np.logical_and,
    "OR": np.logical_or,
    # A product would make NaN of zero times infinity.
    "IF_ELSE_ZERO": lambda condition, value, out: np.copyto(out, np.where(condition, value, 0.0)),
    "INV": np.reciprocal,
}
_OPERATIONS = {getattr(ca, f"OP_{name}"): ufunc for name, ufunc in _UFUNCS.items()}
_KNOWN = _OPERATIONS.keys() | {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST}


class Columns(Rebuilt):
    """A function of dense inputs, evaluated for many columns.

    The `shared` inputs (by position, none of them the first) are the same in all columns.

    CasADi evaluates fewer columns than `fewest`, because the layout of registers for another number
    of columns takes some milliseconds. It also evaluates functions that are not SX or contain an
    operation without a ufunc.

    Attributes
    ----------
    function : casadi.Function
        It, with dense inputs and outputs.
    """

    def __init__(
        self, function: ca.Function, shared: tuple[int, ...] = (), fewest: int = FEWEST
    ) -> None:
        self.function, self._shared = _dense(function), shared
        # Searches end one by one: layouts for past numbers of columns are not used again.
        self._layout = lru_cache(12)(partial(_layout, self.function, shared, fewest))

    def __call__(self, *inputs: Array) -> Sequence[Array]:
        """Return the outputs, (numel, m) each, for inputs (numel, m), shared ones (numel,)."""
        m = inputs[0].shape[1]
        f = self.function
        outputs = [np.empty((f.numel_out(k), m)) for k in range(f.n_out())]
        # Equal shares need only one layout of the registers.
        width = math.ceil(m / math.ceil(m / CHUNK)) if m else 1
        for begin in range(0, m, width):
            columns = slice(begin, min(begin + width, m))
            part = [v if k in self._shared else v[:, columns] for k, v in enumerate(inputs)]
            self._layout(columns.stop - begin).run(part, [v[:, columns] for v in outputs])

        return outputs


def _layout(
    function: ca.Function, shared: tuple[int, ...], fewest: int, m: int
) -> "_Mapped | _Registers":
    """Return a function for m columns; registers from the `fewest` on, if numpy can do it all."""
    # A ufunc takes 0.2 µs for any number of columns, CasADi's operation 1.6 ns for each. But the
    # layout takes 2 µs an operation.
    if (
        m >= fewest
        and function.is_a("SXFunction")
        and _KNOWN.issuperset(map(function.instruction_id, range(function.n_instructions())))
    ):
        return _Registers(function, shared, m)
    return _Mapped(function, shared, m)


@one_thread_at_a_time
def first_order(inputs: Sequence[ca.SX], cost: ca.SX) -> Columns:
    """Return a cost (1, m) of m columns with its gradient (p, m) by the first of the inputs."""
    outputs = [ca.densify(value) for value in (cost, ca.gradient(cost, inputs[0]))]
    derivatives = ca.Function("gradient", [*inputs], outputs)
    return Columns(derivatives, fewest=FEWEST_IN_A_FEW_CALLS)


@one_thread_at_a_time
def second_order(inputs: Sequence[ca.SX], cost: ca.SX) -> Columns:
    """Return a cost (1, m) of m columns, with its gradient (p, m) and Hessian (p * p, m).

    They are its derivatives by the first of the inputs.
    """
    hessian, gradient = ca.hessian(cost, inputs[0])
    outputs = [ca.densify(value) for value in (cost, gradient, ca.vec(hessian))]
    derivatives = ca.Function("derivatives", [*inputs], outputs)
    return Columns(derivatives, fewest=FEWEST_IN_A_FEW_CALLS)


@one_thread_at_a_time
def _dense(function: ca.Function) -> ca.Function:
    """Return the function with dense inputs and outputs."""
    # Columns are read by position: structural zeros need a place too.
    if (function.nnz_in(), function.nnz_out()) == (function.numel_in(), function.numel_out()):
        return function

    inputs = input_symbols(function)
    outputs = [ca.densify(value) for value in function.call(inputs)]
    return ca.Function(function.name(), inputs, outputs)


class Remembering(Rebuilt):
    """A function of arrays that returns its last two results again for equal inputs.

    Nobody may change either: of long records, copies would take a tenth of the time.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._last: list[tuple[Any, Any]] = []

    def __call__(self, *inputs: Array) -> Any:
        """Return the outputs."""
        # Another thread may replace the list meanwhile.
        last = self._last
        for earlier, results in last:
            if all(map(np.array_equal, inputs, earlier)):
                return results
        results = self._function(*inputs)
        self._last = [*last[-1:], (inputs, results)]
        return results


class _Mapped:
    """A function of dense inputs and outputs mapped over m columns, with its own memory."""

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

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Write the outputs, (numel, m) each."""
        for memory, value in zip(self._inputs, inputs, strict=True):
            memory[...] = value.T
        self._call()
        for memory, value in zip(self._outputs, outputs, strict=True):
            value[...] = memory.T


class _Registers:
    """The instructions of an SX function as calls of numpy on registers for m columns."""

    def __init__(self, function: ca.Function, shared: tuple[int, ...], m: int) -> None:
        self._reads: list[tuple[int, int, Array]] = []
        self._calls: list[tuple[Callable[..., Any], tuple[Any, ...]]] = []
        self._outputs = list[Array]()
        wide: dict[int, Array] = {}
        current: dict[int, Array] = {}

        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            sources, targets = function.instruction_input(k), function.instruction_output(k)
            if operation == ca.OP_OUTPUT:
                self._calls.append((_write, (self._outputs, *targets, current[sources[0]])))
                continue
            if operation == ca.OP_CONST:
                value = np.array(function.instruction_constant(k))
            elif operation == ca.OP_INPUT:
                value = np.empty(() if sources[0] in shared else m)
                self._reads.append((sources[0], sources[1], value))
            else:
                arguments = [current[source] for source in sources]
                if operation == ca.OP_TWICE:
                    arguments *= 2
                is_narrow = arguments[0].ndim == arguments[-1].ndim == 0
                # The result of shared numbers may be read much later: it needs its own register.
                value = np.empty(()) if is_narrow else wide.setdefault(targets[0], np.empty(m))
                self._calls.append((_OPERATIONS[operation], (*arguments, value)))
            current[targets[0]] = value

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Write the outputs, (numel, m) each."""
        self._outputs[:] = outputs
        for source, row, register in self._reads:
            register[...] = inputs[source][row]
        with np.errstate(all="ignore"):
            for call, arguments in self._calls:
                call(*arguments)
        self._outputs.clear()  # those of a long record would stay in memory


def _write(outputs: Sequence[Array], output: int, row: int, value: Array) -> None:
    outputs[output][row] = value
