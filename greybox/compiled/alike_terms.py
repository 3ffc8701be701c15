"""Costs that are sums of similar terms, with derivatives built for one term and evaluated for all.

A response has a term for every frequency, and these terms differ only in their constants. The
Hessian of one term is built in a fraction of the time of the Hessian of the sum, and all terms of a
few searches are enough columns for numpy. `response_map` does this for responses as formulas, which
IPOPT evaluates; here the terms are found in any cost.

Members of a study often have one structure and other constants: other data, bounds and fixed
values. The derivatives of a small response take longer to build than its minimum takes to find, so
for few searches they are built once for a `Structure`, with the constants as an input.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import casadi as ca
import numpy as np

from greybox.compiled.vectorized import CHUNK, Columns
from greybox.files.arrays import Array
from greybox.modeling.formula_structure import walk
from greybox.modeling.one_thread import PerThread, cached_property, one_thread_at_a_time

# Columns from which registers of numpy pay within a few calls: their layout takes 1.5 µs for every
# operation.
FEWEST_COLUMNS = 512

# Instructions of a function up to which its structure is shared.
SMALL = 1500


@dataclass(frozen=True)
class Structure:
    """An SX function without its constants: its instructions, and the first that had them.

    Unknowns that occur nowhere count too: `unknowns` is the size of its first input.
    """

    unknowns: int
    form: tuple[tuple[int, ...], ...]
    function: ca.Function = field(compare=False)

    def opened(self) -> ca.Function:
        """(x, p) -> the first output (k,), and nothing.

        In p are all inputs but the first, and then the constants.
        """
        x, *inputs = self.function.sx_in()
        constants = ca.SX.sym("constants", sum(row[0] == ca.OP_CONST for row in self.form))
        remaining = iter(ca.vertsplit(constants))
        outputs = walk(self.function, [x, *inputs], lambda _: next(remaining))
        p = ca.vertcat(*inputs, constants)
        return ca.Function("opened", [x, p], [ca.vertcat(*outputs), ca.SX(0, 1)])


def structure_of(function: ca.Function) -> tuple[Structure, Array]:
    """Return the structure of an SX function, and its constants in their order."""
    places = range(function.n_instructions())
    operations = [function.instruction_id(k) for k in places]
    form = tuple(
        (operation, *function.instruction_input(k), *function.instruction_output(k))
        for k, operation in zip(places, operations, strict=True)
    )
    constants = [function.instruction_constant(k) for k in places if operations[k] == ca.OP_CONST]
    return Structure(function.numel_in(0), form, function), np.array(constants)


class SecondOrder:
    """A scalar function with gradient and Hessian by its first input, for many columns."""

    def __init__(self, program: ca.Function) -> None:
        """Take an SX function with the cost as first output."""
        self._program = program

    @cached_property
    @one_thread_at_a_time
    def _terms(self) -> tuple[list[tuple[Columns, Array]], Columns | None]:
        """Return groups of similar terms with their constants, and what remains."""
        inputs = self._program.sx_in()
        # Grouping pays for every size: a thousand searches on ten frequencies take a fifth less
        # time, and on 40 to 100 frequencies half the time.
        groups, remainder = grouped(inputs, self._program(*inputs)[0])
        functions = [
            (Columns(_derivatives([*inputs, symbols], term)), constants)
            for term, symbols, constants in groups
        ]
        if groups and remainder.is_zero():
            return functions, None
        return functions, Columns(_derivatives(inputs, remainder), fewest=FEWEST_COLUMNS)

    @cached_property
    def _structure(self) -> tuple[Structure, Array]:
        return structure_of(self._program)

    def of_few(self, *inputs: Array) -> tuple[Array, Array, Array]:
        """Return the same as a call does, by derivatives that all functions of a structure share.

        Functions of more than `SMALL` instructions are faster term by term.
        """
        if self._program.n_instructions() > SMALL:
            return self(*inputs)
        structure, constants = self._structure
        columns = np.repeat(constants[:, None], inputs[0].shape[1], axis=1)
        p = np.concatenate([*inputs[1:], columns])
        cost, gradient, hessian = _shared_derivatives.result(structure)(inputs[0], p)
        return cost[0], gradient, hessian

    def __call__(self, *inputs: Array) -> tuple[Array, Array, Array]:
        """Return cost (m,), gradient (p, m) and Hessian (p * p, m) for inputs (numel, m)."""
        p, m = inputs[0].shape
        groups, remainder = self._terms
        if remainder is None:
            values = [np.zeros((size, m)) for size in (1, p, p * p)]
        else:
            values = remainder(*inputs)
        for function, constants in groups:
            # All terms at once would not fit into the cache.
            total = constants.shape[1]
            width = math.ceil(total / math.ceil(total / max(CHUNK // m, 1)))
            for begin in range(0, total, width):
                piece = constants[:, begin : begin + width]
                count = piece.shape[1]
                # np.tile takes three times as long on few columns.
                repeated = (np.concatenate([value] * count, axis=1) for value in inputs)
                terms = function(*repeated, np.repeat(piece, m, axis=1))
                for k, of_terms in enumerate(terms):
                    values[k] += of_terms.reshape(-1, count, m).sum(axis=1)

        cost, gradient, hessian = values
        return cost[0], gradient, hessian


class _Group(NamedTuple):
    """Similar terms.

    One of them is the expression. Its symbols (c,) are the constants that differ; their values are
    (c, n).
    """

    term: ca.SX
    symbols: ca.SX
    constants: Array


def _derivatives(inputs: Sequence[ca.SX], cost: ca.SX) -> ca.Function:
    hessian, gradient = ca.hessian(cost, inputs[0])
    outputs = [cost, ca.densify(gradient), ca.vec(ca.densify(hessian))]
    return ca.Function(
        "derivatives", [*inputs], [ca.densify(value) for value in outputs], {"cse": True}
    )


def _derivatives_of(structure: Structure) -> Columns:
    program = structure.opened()
    inputs = program.sx_in()
    return Columns(_derivatives(inputs, program(*inputs)[0]), fewest=FEWEST_COLUMNS)


_shared_derivatives = PerThread(_derivatives_of, 16)


def grouped(inputs: Sequence[ca.SX], cost: ca.SX) -> tuple[list[_Group], ca.SX]:
    """Return the groups of similar terms of a cost, and the sum of the other terms."""
    by_form = defaultdict(list)
    for factor, term in summands(cost):
        function = ca.Function("term", [*inputs], [term])
        structure, constants = structure_of(function)
        by_form[structure].append((factor, term, function, constants))

    groups, remainder = [], ca.SX(0)
    for members in by_form.values():
        if len(members) < 4:  # not worth a function
            remainder += sum(factor * term for factor, term, *_ in members)
            continue
        table = np.array([[factor, *constants] for factor, _, _, constants in members]).T
        differs = np.ptp(table, axis=1) > 0
        symbols = ca.SX.sym("constant", int(differs.sum()))
        values = [ca.SX(value) for value in table[:, 0]]
        for k, place in enumerate(np.flatnonzero(differs)):
            values[place] = symbols[k]
        # CasADi cannot substitute constants: the instructions are repeated with symbols instead.
        remaining = iter(values[1:])
        [term] = walk(members[0][2], inputs, lambda _, remaining=remaining: next(remaining))
        groups.append(_Group(values[0] * term, symbols, table[differs]))

    return groups, remainder


def summands(cost: ca.SX) -> list[tuple[float, ca.SX]]:
    """Return the terms of a sum with their factors."""
    terms, waiting = [], [(1.0, cost)]
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
            constant, variable = sorted(parts, key=ca.SX.is_constant, reverse=True)
            waiting.append((factor * float(constant), variable))
        elif term.is_op(ca.OP_DIV) and parts[1].is_constant():
            waiting.append((factor / float(parts[1]), parts[0]))
        else:
            terms.append((factor, term))

    return terms
