"""The operations of a formula, one by one, and the means of its switches over an interval.

A sampled sign or comparison is a step function of its argument, without a slope that a solver could
follow. So each is replaced by its mean over one sampling interval, in which the argument moves
evenly: a ramp as wide as that motion.
"""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca

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


def applied(operation: int, terms: Sequence[Any]) -> Any:
    """Return the result of one of CasADi's operations on one or two terms."""
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
    """
    registers: dict[int, Any] = {}
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


def with_finite_slopes(formula: ca.SX) -> ca.SX:
    """Return `formula` (k, 1) with a slope of zero where a guarded root or power is zero.

    Below zero, the chain rule of a guarded root, sqrt(max(h, 0)), multiplies zero by infinity. Of
    60 fits of two tanks that run empty, 26 did not converge for that, some after 2100 iterations.
    """

    def operate(operation: int, terms: list[ca.SX]) -> ca.SX:
        value = applied(operation, terms)
        # The slope of a root without a guard is infinite: initial states avoid its zero.
        if operation not in ROOTS or not has_switches(terms[0]):
            return value
        exponent = terms[1] if len(terms) > 1 else 0.5
        return ca.if_else(ca.logic_or(terms[0] != 0, exponent <= 0), value, 0)

    symbols = ca.symvar(formula)
    program = ca.Function("formula", [ca.vertcat(*symbols)], [ca.densify(formula)])
    return ca.vertcat(*walk(program, [symbols], operate=operate))


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
