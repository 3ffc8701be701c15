"""Costs that are sums of similar terms, with derivatives built for one term and evaluated for all.

A response has a term for every frequency, and these terms differ only in their constants and in
the data that they read. The Hessian of one term is built in a fraction of the time of the Hessian
of the sum, and all terms of a few searches are enough columns for numpy.
"""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from greybox.compiled.vectorized import Columns
from greybox.files.arrays import Array, ArrayTriple, IntArray
from greybox.modeling.formula_structure import walk
from greybox.modeling.one_thread import one_thread_at_a_time

# Number of columns from which registers of numpy save time within a few calls: their layout takes
# 1.5 µs for every operation.
FEWEST_COLUMNS = 512
DATA = 2  # the input with the data


class SecondOrder:
    """A scalar function of many columns, with gradient and Hessian in its first input.

    Its third input are data: terms of one form read them at different places.
    """

    @one_thread_at_a_time
    def __init__(self, inputs: Sequence[ca.SX], cost: ca.SX) -> None:
        """Take the symbols of the inputs and the cost."""
        # Grouping saves time for every size: a thousand searches on ten frequencies take a fifth
        # less time, and on 40 to 100 frequencies half the time.
        groups, remainder = grouped(inputs, cost)
        self._groups = [
            (Columns(_derivatives([*_others(inputs), group.symbols], group.term)), group)
            for group in groups
        ]
        self._remainder = Columns(_derivatives(inputs, remainder), fewest=FEWEST_COLUMNS)

    def __call__(self, *inputs: Array) -> ArrayTriple:
        """Return cost (m,), gradient (p, m) and Hessian (p * p, m) for inputs (numel, m)."""
        m = inputs[0].shape[1]
        values = [*self._remainder(*inputs)]
        for function, (_, _, constants, places) in self._groups:
            count = constants.shape[1]
            repeated = (np.tile(value, count) for value in _others(inputs))
            data = inputs[DATA][places].reshape(len(places), count * m)
            numbers = np.concatenate([np.repeat(constants, m, axis=1), data])
            for k, terms in enumerate(function(*repeated, numbers)):
                values[k] += terms.reshape(-1, count, m).sum(axis=1)

        cost, gradient, hessian = values
        return cost[0], gradient, hessian


class _Group(NamedTuple):
    """Similar terms.

    One of them is the expression. Its symbols (c + d,) are the constants that differ, with the
    values (c, n), and the data, at the places (d, n) of the input.
    """

    term: ca.SX
    symbols: ca.SX
    constants: Array
    places: IntArray


def _others(inputs: Sequence[Any]) -> list[Any]:
    """Return the inputs without the data."""
    return [value for k, value in enumerate(inputs) if k != DATA]


def _derivatives(inputs: Sequence[ca.SX], cost: ca.SX) -> ca.Function:
    hessian, gradient = ca.hessian(cost, inputs[0])
    outputs = [ca.densify(value) for value in (cost, gradient, ca.vec(hessian))]
    return ca.Function("derivatives", [*inputs], outputs, {"cse": True})


def grouped(inputs: Sequence[ca.SX], cost: ca.SX) -> tuple[list[_Group], ca.SX]:
    """Return the groups of similar terms of a cost, and the sum of the other terms."""
    by_form = defaultdict(list)
    for factor, term in summands(cost):
        function = ca.Function("term", [*inputs], [term])
        # Terms of one form differ only in their constants, and in the places of their data.
        form = []
        constants = [factor]
        places = []
        for k in range(function.n_instructions()):
            operation, source = function.instruction_id(k), function.instruction_input(k)
            if operation == ca.OP_CONST:
                constants.append(function.instruction_constant(k))
            elif operation == ca.OP_INPUT and source[0] == DATA:
                places.append(source.pop())
            form.append((operation, *source, *function.instruction_output(k)))
        by_form[tuple(form)].append((factor, term, function, constants, places))

    groups = []
    remainder = ca.SX(0)
    for members in by_form.values():
        if len(members) < 4:  # not worth a function
            remainder += sum(factor * term for factor, term, *_ in members)
            continue
        table = np.array([constants for *_, constants, _ in members]).T
        places = np.array([places for *_, places in members], dtype=int).T
        differs = np.flatnonzero(np.ptp(table, axis=1))
        symbols = ca.SX.sym("constant", len(differs) + len(places))
        values = [ca.SX(value) for value in table[:, 0]]
        for k, place in enumerate(differs):
            values[place] = symbols[k]
        first = [*inputs]
        first[DATA] = ca.SX(inputs[DATA])
        for k, place in enumerate(places[:, 0].tolist(), len(differs)):
            first[DATA][place] = symbols[k]
        # CasADi cannot substitute constants: the instructions are repeated with symbols instead.
        remaining = iter(values[1:])
        [term] = walk(members[0][2], first, lambda _, remaining=remaining: next(remaining))
        groups.append(_Group(values[0] * term, symbols, table[differs], places))

    return groups, remainder


def summands(cost: ca.SX) -> list[tuple[float, ca.SX]]:
    """Return the terms of a sum with their factors."""
    terms = []
    waiting = [(1.0, cost)]
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
