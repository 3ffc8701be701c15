"""The operations of a formula, one by one, and the means of its switches over an interval.

A sampled sign or comparison is a step function of its argument, without a slope that a solver could
follow. So each is replaced by its mean over one sampling interval, in which the argument moves
evenly: a ramp as wide as that motion.
"""

from collections.abc import Callable, Sequence

import casadi as ca

SWITCHES = {ca.OP_SIGN, ca.OP_LT, ca.OP_LE, ca.OP_FMIN, ca.OP_FMAX}
JUMPS = {ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_COPYSIGN}


def applied(operation: int, terms: Sequence[ca.SX]) -> ca.SX:
    """Return the result of one of CasADi's operations on one or two terms."""
    return ca.SX.unary(operation, *terms) if len(terms) == 1 else ca.SX.binary(operation, *terms)


def walk(
    program: ca.Function,
    inputs: Sequence[ca.SX],
    constant: Callable[[float], ca.SX] = ca.SX,
    operate: Callable[[int, list[ca.SX]], ca.SX] = applied,
) -> list[ca.SX]:
    """Evaluate an SX function with a dense result (k, 1) operation by operation.

    `constant` is applied to its numbers, in their order.
    """
    registers: dict[int, ca.SX] = {}
    results = [ca.SX(0)] * program.numel_out(0)
    for k in range(program.n_instructions()):
        operation = program.instruction_id(k)
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
        # A negligible number avoids a division by zero where nothing moves; the products of smaller
        # ones overflow in derivatives.
        return interval / 2 * ca.sqrt(ca.dot(gradient, slopes) ** 2 + least + 1e-100)

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

        return applied(operation, terms)

    # A CasADi function has no free symbols: the others are its second input.
    inputs = [z, ca.vertcat(*[s for s in ca.symvar(formula) if not ca.depends_on(s, z)])]
    program = ca.Function("formula", inputs, [ca.densify(formula)])
    return ca.vertcat(*walk(program, inputs, operate=operate))
