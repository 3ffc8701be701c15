"""The operations of a formula, one by one, and the means of its switches over an interval.

A formula may hold CasADi functions that stay calls: tables, roots, integrators, callbacks. What is
not one of `ELEMENTARY`'s operations is not taken apart, but used as it is (`is_elementary`).

A sampled sign or comparison is a step function of its argument, without a slope that a solver could
follow. So each is replaced by its mean over one sampling interval, in which the argument moves
evenly: a ramp as wide as that motion.
"""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca

# CasADi's operations on one scalar, then on two. Asked to apply any other one to scalars, such as a
# call, CasADi returns zero without a word.
ELEMENTARY = {
    *(ca.OP_ASSIGN, ca.OP_NEG, ca.OP_INV, ca.OP_SQ, ca.OP_TWICE, ca.OP_SQRT, ca.OP_NOT),
    *(ca.OP_EXP, ca.OP_EXPM1, ca.OP_LOG, ca.OP_LOG1P, ca.OP_ERF, ca.OP_ERFINV),
    *(ca.OP_SIN, ca.OP_COS, ca.OP_TAN, ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATAN),
    *(ca.OP_SINH, ca.OP_COSH, ca.OP_TANH, ca.OP_ASINH, ca.OP_ACOSH, ca.OP_ATANH),
    *(ca.OP_SIGN, ca.OP_FABS, ca.OP_FLOOR, ca.OP_CEIL),
    *(ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_POW, ca.OP_CONSTPOW),
    *(ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_AND, ca.OP_OR, ca.OP_IF_ELSE_ZERO),
    *(ca.OP_FMIN, ca.OP_FMAX, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_COPYSIGN),
    *(ca.OP_ATAN2, ca.OP_HYPOT),
}

SWITCHES = {ca.OP_SIGN, ca.OP_LT, ca.OP_LE, ca.OP_FMIN, ca.OP_FMAX}
KINKS = {ca.OP_FABS, ca.OP_FMIN, ca.OP_FMAX}
ROOTS = {ca.OP_SQRT, ca.OP_POW, ca.OP_CONSTPOW}
JUMPS = {ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_COPYSIGN}
# Operations by their terms; of a switch also by the mean sign, or magnitude, of a, or of a - b.
MEANS: dict[int, Callable[..., ca.SX]] = {
    ca.OP_SIGN: lambda a, sign: sign,
    ca.OP_FABS: lambda a, magnitude: magnitude,
    ca.OP_FMIN: lambda a, b, magnitude: (a + b - magnitude) / 2,
    ca.OP_FMAX: lambda a, b, magnitude: (a + b + magnitude) / 2,
    ca.OP_LT: lambda a, b, sign: (1 - sign) / 2,
    ca.OP_LE: lambda a, b, sign: (1 - sign) / 2,
    # Conditions are now shares of the interval, no longer 0 or 1.
    ca.OP_NOT: lambda a: 1 - a,
    ca.OP_AND: lambda a, b: a * b,
    ca.OP_OR: lambda a, b: a + b - a * b,
    ca.OP_IF_ELSE_ZERO: lambda share, a: ca.if_else(share == 0, 0, share * a),
}


def is_elementary(program: ca.Function) -> bool:
    """Return whether every operation of an SX function is one of `ELEMENTARY`."""
    ends = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST}
    return (ELEMENTARY | ends).issuperset(operations(program))


def operations(program: ca.Function) -> list[int]:
    """Return CasADi's number of every operation of an SX function or an MX function, in order."""
    return [program.instruction_id(k) for k in range(program.n_instructions())]


def program_of(formula: ca.SX) -> ca.Function:
    """Return a function of all symbols of a formula that evaluates it."""
    return ca.Function("formula", [*ca.symvar(formula)], [formula])


def applied(operation: int, terms: Sequence[Any]) -> Any:
    """Return the result of one of the `ELEMENTARY` operations on one or two terms."""
    kind = type(terms[0])
    return kind.unary(operation, *terms) if len(terms) == 1 else kind.binary(operation, *terms)


def walk(
    program: ca.Function,
    inputs: Sequence[Any],
    constant: Callable[[float], Any] = ca.SX,
    operate: Callable[[int, list[Any]], Any] = applied,
) -> list[Any]:
    """Evaluate an SX function with a dense result (k, 1) operation by operation.

    `constant` is applied to its numbers, in their order.

    Raises
    ------
    ValueError
        If an operation is not one of `ELEMENTARY`.
    """
    if not is_elementary(program):
        names = ", ".join(repr(f.name()) for f in program.find_functions(0)) or "an operation"
        raise ValueError(
            f"a response at finite amplitude cannot average the switches in or beside {names} of "
            "CasADi: write its formula in place of its call."
        )

    registers: dict[int, Any] = {}
    results = [ca.SX(0)] * program.numel_out(0)
    for k, operation in enumerate(operations(program)):
        sources, targets = program.instruction_input(k), program.instruction_output(k)
        if operation == ca.OP_CONST:
            registers[targets[0]] = constant(program.instruction_constant(k))
        elif operation == ca.OP_INPUT:
            registers[targets[0]] = inputs[sources[0]][sources[1]]
        elif operation == ca.OP_OUTPUT:
            results[targets[1]] = registers[sources[0]]
        else:
            registers[targets[0]] = operate(operation, [registers[i] for i in sources])

    return results


def rewritten(formula: ca.SX, rule: Callable[[int, list[ca.SX]], ca.SX | None]) -> ca.SX:
    """Return a dense `formula` (k, 1) with some of its elementary operations replaced.

    ``rule(operation, terms)`` gives what replaces an operation, or None. What is not elementary
    stays the same node of CasADi's graph, and so does everything in which nothing was replaced.
    """
    entries = ca.densify(formula).nz[:]
    results: dict[int, ca.SX] = {}

    pending = ca.vertsplit(entries)
    while pending:
        node = pending[-1]
        terms = [node.dep(k) for k in range(node.n_dep())] if node.op() in ELEMENTARY else []
        waiting = [term for term in terms if term.element_hash() not in results]
        if waiting:
            pending += waiting
            continue
        pending.pop()
        if node.element_hash() not in results:
            results[node.element_hash()] = _with_replaced_terms(node, terms, results, rule)

    return ca.vertcat(*[results[node.element_hash()] for node in ca.vertsplit(entries)])


def _with_replaced_terms(
    node: ca.SX,
    terms: list[ca.SX],
    results: dict[int, ca.SX],
    rule: Callable[[int, list[ca.SX]], ca.SX | None],
) -> ca.SX:
    if not terms:
        return node
    new_terms = [results[term.element_hash()] for term in terms]
    replacement = rule(node.op(), new_terms)
    if replacement is not None:
        return replacement
    pairs = zip(new_terms, terms, strict=True)
    if all(new.element_hash() == old.element_hash() for new, old in pairs):
        return node
    return applied(node.op(), new_terms)


def with_finite_slopes(formula: ca.SX) -> ca.SX:
    """Return `formula` (k, 1) with a slope of zero where a guarded root or power is zero.

    Below zero, the chain rule of a guarded root, sqrt(max(h, 0)), multiplies zero by infinity. Of
    60 fits of two tanks that run empty, 26 did not converge for that, some after 2100 iterations.
    """
    if ROOTS.isdisjoint(operations(program_of(formula))):
        return ca.densify(formula)

    def finite(operation: int, terms: list[ca.SX]) -> ca.SX | None:
        # The slope of a root without a guard is infinite: initial states avoid its zero.
        if operation not in ROOTS or not has_switches(terms[0]):
            return None
        exponent = terms[1] if len(terms) > 1 else 0.5
        value = applied(operation, terms)
        return ca.if_else(ca.logic_or(terms[0] != 0, exponent <= 0), value, 0)

    return rewritten(formula, finite)


def has_switches(formula: ca.SX) -> bool:
    """Return whether `formula` has a sign, a comparison, a minimum or a maximum.

    Functions of CasADi that it calls count where they are made of operations.
    """
    program = program_of(formula)
    programs = [f for f in program.find_functions() if f.is_a("SXFunction") or f.is_a("MXFunction")]
    return any(not SWITCHES.isdisjoint(operations(f)) for f in (program, *programs))


def interval_means(formula: ca.SX, z: ca.SX, slopes: ca.SX, sizes: ca.SX, interval: float) -> ca.SX:
    """Return `formula` (k, 1) with the mean over a sampling interval in place of every switch.

    In the middle of the interval the signals are `z`, with `slopes`. A switch whose argument rests,
    as the speed in stiction, switches as slowly as if its signals had a twentieth of the slopes
    `sizes`: otherwise it would switch at once, without a derivative.

    Raises
    ------
    ValueError
        For a rounding or a remainder, which have many jumps.
    """

    def operate(operation: int, rows: list[ca.SX]) -> ca.SX:
        # Gradients go from operation to operation: derived anew for every switch, from switches
        # within its argument, they would be five times as many operations.
        values, gradients = ca.horzsplit(ca.vertcat(*rows), [0, 1, 1 + z.numel()])
        is_moving = gradients.nnz() > 0
        if is_moving and operation in JUMPS:
            raise ValueError(
                "a rounding, a remainder or a copied sign has no response at finite amplitude: "
                "write it with gb.sign or gb.where."
            )
        if is_moving and operation in SWITCHES | KINKS:
            signs = ca.SX([1, -1][: len(rows)]).T
            argument, gradient = signs @ values, signs @ gradients
            least = ca.sumsqr(gradient * sizes.T / 20)
            # A negligible number avoids a division by zero where nothing moves; the products of
            # smaller ones overflow in derivatives.
            width = interval / 2 * ca.sqrt((gradient @ slopes) ** 2 + least + 1e-100)
            mean = slope = ca.fmax(ca.fmin(argument / width, 1), -1)
            if operation in KINKS:
                # The mean of |a| over a ramp that crosses zero is a parabola.
                mean = slope * argument + width * (1 - slope**2) / 2
            else:
                slope = (ca.fabs(argument) < width) / width
            values, gradients = ca.vertcat(values, mean), ca.vertcat(gradients, slope * gradient)

        terms = ca.SX.sym("terms", values.numel())
        plain = MEANS.get(operation) if is_moving else None
        parts = ca.vertsplit(terms)
        result = plain(*parts) if plain else applied(operation, parts)
        result, slope = ca.substitute([result, ca.jacobian(result, terms)], [terms], [values])
        return ca.horzcat(result, slope @ gradients)

    # A CasADi function has no free symbols: the others are its second input.
    others = ca.vertcat(*[s for s in ca.symvar(formula) if not ca.depends_on(s, z)])
    program = ca.Function("formula", [z, others], [ca.densify(formula)])
    moving = ca.horzcat(z, ca.SX.eye(z.numel()))
    constant = ca.horzcat(others, ca.SX(others.numel(), z.numel()))
    inputs = [*map(ca.vertsplit, (moving, constant))]
    rows = walk(program, inputs, lambda c: ca.horzcat(c, ca.SX(1, z.numel())), operate)
    return ca.vertcat(*rows)[:, 0]
