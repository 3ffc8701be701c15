"""The operations of a formula, one by one, and the means of its switches over an interval.

A sampled sign or comparison is a step function of its argument, without a slope that a solver could
follow. So each is replaced by its mean over one sampling interval, in which the argument moves
evenly: a ramp as wide as that motion.
"""

from collections.abc import Callable
from typing import Any

import casadi as ca

SWITCHES = {ca.OP_SIGN, ca.OP_LT, ca.OP_LE, ca.OP_FMIN, ca.OP_FMAX}
JUMPS = {ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_COPYSIGN}


def walk(
    formula: ca.SX,
    z: ca.SX,
    symbols: list[Any],
    constant: Callable[[ca.SX], Any],
    operate: Callable[[int, list[Any]], Any],
) -> list[Any]:
    """Evaluate `formula` (k, 1) operation by operation.

    `symbols` replace the entries of z; `constant` is applied to numbers and to all other symbols.
    """
    # A CasADi function has no free symbols: the others are its second input.
    constants = [s for s in ca.symvar(formula) if not ca.depends_on(s, z)]
    program = ca.Function("formula", [z, ca.vertcat(*constants)], [ca.densify(formula)])
    registers: dict[int, Any] = {}
    results: list[Any] = [None] * formula.numel()

    for k in range(program.n_instructions()):
        operation = program.instruction_id(k)
        inputs = program.instruction_input(k)
        outputs = program.instruction_output(k)
        if operation == ca.OP_CONST:
            registers[outputs[0]] = constant(ca.SX(program.instruction_constant(k)))
        elif operation == ca.OP_INPUT:
            registers[outputs[0]] = (
                symbols[inputs[1]] if inputs[0] == 0 else constant(constants[inputs[1]])
            )
        elif operation == ca.OP_OUTPUT:
            results[outputs[1]] = registers[inputs[0]]
        else:
            registers[outputs[0]] = operate(operation, [registers[i] for i in inputs])

    return results


def has_switches(formula: ca.SX) -> bool:
    """Return whether `formula` has a sign, a comparison, a minimum or a maximum."""
    program = ca.Function("formula", [*ca.symvar(formula)], [formula])
    return any(program.instruction_id(k) in SWITCHES for k in range(program.n_instructions()))


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

    def reach(argument: ca.SX) -> ca.SX:
        gradient = ca.gradient(argument, z)
        least = ca.sumsqr(gradient * sizes / 20)
        # The smallest number avoids a division by zero where nothing moves.
        return interval / 2 * ca.sqrt(ca.dot(gradient, slopes) ** 2 + least + 1e-300)

    def sign(a: ca.SX) -> ca.SX:
        return ca.fmax(ca.fmin(a / reach(a), 1), -1)

    def magnitude(a: ca.SX) -> ca.SX:
        # The mean of |a| over a ramp that crosses zero is a parabola.
        width = reach(a)
        return ca.if_else(ca.fabs(a) < width, (a**2 / width + width) / 2, ca.fabs(a))

    means: dict[int, Callable[..., ca.SX]] = {
        ca.OP_SIGN: sign,
        ca.OP_FABS: magnitude,
        ca.OP_FMIN: lambda a, b: (a + b - magnitude(a - b)) / 2,
        ca.OP_FMAX: lambda a, b: (a + b + magnitude(a - b)) / 2,
        ca.OP_LT: lambda a, b: (1 + sign(b - a)) / 2,
        ca.OP_LE: lambda a, b: (1 + sign(b - a)) / 2,
        # Conditions are shares of the interval now, no longer 0 or 1.
        ca.OP_NOT: lambda a: 1 - a,
        ca.OP_AND: lambda a, b: a * b,
        ca.OP_OR: lambda a, b: a + b - a * b,
        ca.OP_IF_ELSE_ZERO: lambda share, a: ca.if_else(share == 0, 0, share * a),
    }

    def operate(operation: int, terms: list[ca.SX]) -> ca.SX:
        if ca.depends_on(ca.vertcat(*terms), z):
            if operation in JUMPS:
                raise ValueError(
                    "a rounding, a remainder or a copied sign has no response at finite amplitude: "
                    "write it with gb.sign or gb.where."
                )
            if operation in means:
                return means[operation](*terms)

        if len(terms) == 1:
            return ca.SX.unary(operation, *terms)
        return ca.SX.binary(operation, *terms)

    return ca.vertcat(*walk(formula, z, ca.vertsplit(z), lambda constant: constant, operate))
