"""Costs that are sums of terms of one form, with their derivatives: built for one term, evaluated for all of them.

A response has a term for every frequency, and these differ in their constants alone. The Hessian of
one term is built in a fraction of the time that the Hessian of the sum takes, and few searches at
once are columns enough for numpy.
"""

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from greybox.compiled.vectorized import CHUNK, Columns
from greybox.files.arrays import Array
from greybox.modeling.one_thread import one_thread_at_a_time

# Instructions of cost, gradient and Hessian, some two for every operation of the cost and input,
# from which terms are taken together also for few columns: a step of eight searches on ten points
# (5000) takes a fifth longer so, on forty (25 000) half the time. Of a thousand searches on ten
# points all take a twentieth less time, on 36 an eighth, since functions of one term are built and
# laid out in a tenth of the time.
LARGE = 10_000
FEWEST_ALIKE = 4  # terms that are worth a function of their own

# Columns from which registers of numpy, which take 1.5 µs to lay out for every operation, are
# repaid within a few calls where operations are many.
FEWEST_COLUMNS = 512


class SecondOrder:
    """A scalar function with its gradient and Hessian by the first of its inputs, for many columns of these."""

    def __init__(self, inputs: Sequence[ca.SX], cost: ca.SX) -> None:
        """Take the symbols of the inputs and the cost."""
        self._inputs, self._cost = inputs, cost
        self._is_built = False

    @one_thread_at_a_time
    def _build(self, m: int) -> None:
        """Build for m columns and what follows: of many, and of large sums, terms are taken together."""
        operations = ca.Function("cost", [*self._inputs], [self._cost]).n_instructions()
        is_large = m >= FEWEST_COLUMNS or 2 * operations * self._inputs[0].numel() >= LARGE
        groups, rest = _alike(self._inputs, self._cost) if is_large else ([], self._cost)
        self._groups = [
            (Columns(_derivatives([*self._inputs, g.symbols], g.term)), g.constants) for g in groups
        ]
        self._repeated: dict[
            int, list[list[Array]]
        ] = {}  # constants of every group, by the number of columns
        self._rest: Columns | None = None
        if not (groups and rest.is_zero()):
            self._rest = Columns(_derivatives(self._inputs, rest), fewest=FEWEST_COLUMNS)
        self._is_built = True

    def __call__(self, *inputs: Array) -> tuple[Array, Array, Array]:
        """Return cost (m,), gradient (p, m) and Hessian (p * p, m) for inputs (numel, m)."""
        p, m = inputs[0].shape
        if not self._is_built:
            self._build(m)
        values = (
            [np.zeros((size, m)) for size in (1, p, p * p)]
            if self._rest is None
            else self._rest(*inputs)
        )
        for (function, _), shares in zip(self._groups, self._constants(m), strict=True):
            for constants in shares:
                count = constants.shape[1] // m
                found = function(
                    *(np.concatenate([value] * count, axis=1) for value in inputs), constants
                )
                for k, terms in enumerate(found):
                    values[k] += terms.reshape(-1, count, m).sum(axis=1)
        cost, gradient, hessian = values
        return cost[0], gradient, hessian

    def _constants(self, m: int) -> list[list[Array]]:
        """Return the constants of every group for m columns, in shares of as many terms as the cache holds."""
        if m not in self._repeated:
            shares = (
                np.array_split(c, -(-c.shape[1] // max(CHUNK // m, 1)), axis=1)
                for _, c in self._groups
            )
            self._repeated[m] = [[np.repeat(some, m, axis=1) for some in each] for each in shares]
        return self._repeated[m]


class _Alike(NamedTuple):
    """Terms of one form: one of them, with symbols (c,) for what differs, and the values (c, n) of these."""

    term: ca.SX
    symbols: ca.SX
    constants: Array


def _derivatives(inputs: Sequence[ca.SX], cost: ca.SX) -> ca.Function:
    hessian, gradient = ca.hessian(cost, inputs[0])
    outputs = [cost, ca.densify(gradient), ca.vec(ca.densify(hessian))]
    return ca.Function(
        "derivatives", [*inputs], [ca.densify(value) for value in outputs], {"cse": True}
    )


def _alike(inputs: Sequence[ca.SX], cost: ca.SX) -> tuple[list[_Alike], ca.SX]:
    """Return the terms of a cost by their form, and the sum of those that have few like them."""
    groups = defaultdict(list)
    for factor, term in _terms(cost):
        function = ca.Function("term", [*inputs], [term])
        places = range(function.n_instructions())
        operations = [function.instruction_id(k) for k in places]
        form = tuple(
            (operation, *function.instruction_input(k), *function.instruction_output(k))
            for k, operation in zip(places, operations, strict=True)
        )
        constants = [
            function.instruction_constant(k) for k in places if operations[k] == ca.OP_CONST
        ]
        groups[form].append((factor, term, function, constants))
    found, rest = [], ca.SX(0)
    for members in groups.values():
        if len(members) < FEWEST_ALIKE:
            rest += sum(factor * term for factor, term, *_ in members)
            continue
        table = np.array([[factor, *constants] for factor, _, _, constants in members]).T
        differs = np.ptp(table, axis=1) > 0
        symbols = ca.SX.sym("constant", int(differs.sum()))
        values = [ca.SX(value) for value in table[:, 0]]
        for k, place in enumerate(np.flatnonzero(differs)):
            values[place] = symbols[k]
        function = members[0][2]
        found.append(
            _Alike(
                values[0] * _with_constants(function, inputs, values[1:]), symbols, table[differs]
            )
        )
    return found, rest


def _terms(cost: ca.SX) -> list[tuple[float, ca.SX]]:
    """Return the terms of a sum, and the factor of each."""
    found, waiting = [], [(1.0, cost)]
    while waiting:
        factor, term = waiting.pop()
        parts = [term.dep(k) for k in range(term.n_dep())]
        if term.is_op(ca.OP_ADD):
            waiting += [(factor, part) for part in reversed(parts)]
        elif term.is_op(ca.OP_SUB):
            waiting += [(-factor, parts[1]), (factor, parts[0])]
        elif term.is_op(ca.OP_NEG):
            waiting.append((-factor, parts[0]))
        elif term.is_op(ca.OP_TWICE):
            waiting.append((2 * factor, parts[0]))
        elif term.is_op(ca.OP_MUL) and any(part.is_constant() for part in parts):
            constant, other = sorted(parts, key=ca.SX.is_constant, reverse=True)
            waiting.append((factor * float(constant), other))
        elif term.is_op(ca.OP_DIV) and parts[1].is_constant():
            waiting.append((factor / float(parts[1]), parts[0]))
        else:
            found.append((factor, term))
    return found


def _with_constants(
    function: ca.Function, inputs: Sequence[ca.SX], constants: Sequence[ca.SX]
) -> ca.SX:
    """Return the one output of an SX function with other constants, in their order."""
    registers: dict[int, ca.SX] = {}
    given = iter(constants)
    result = ca.SX(0)
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        sources, [target, *_] = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_INPUT:
            registers[target] = inputs[sources[0]][sources[1]]
        elif operation == ca.OP_CONST:
            registers[target] = next(given)
        elif operation == ca.OP_OUTPUT:
            result = registers[sources[0]]
        elif len(sources) == 1:
            registers[target] = ca.SX.unary(operation, registers[sources[0]])
        else:
            registers[target] = ca.SX.binary(operation, *(registers[source] for source in sources))
    return result
