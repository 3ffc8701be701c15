"""The structure of a formula, read from its operations: the signals in which it is linear, and its switches.

Derivatives do not show it: that of a sign, a comparison or a rounding is zero wherever it exists, so
a relay would look like a constant. So the operations themselves are read, one by one.

A sampled switch is a step function of its argument, without a slope that a solver could follow, and
its error is of the order of the interval. So every sampling interval is cut where a switch turns: the
formula is evaluated in the middle of each piece, with the switches held, and the lengths of the
pieces carry the slope.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from greybox.modeling.one_thread import one_thread_at_a_time

TINY = 1e-300  # avoids a division by zero where nothing moves
SAME = 1e-7  # difference of two sides of a switch that is rounding


@dataclass(frozen=True, eq=False)
class _Term:
    """An expression as ``slopes · z + rest``; `moving` says whether the rest depends on z."""

    slopes: dict[int, ca.SX]
    rest: ca.SX
    moving: bool

    @property
    def constant(self) -> bool:
        """Whether it does not depend on z."""
        return not self.slopes and not self.moving

    def mapped(self, change: Callable[[ca.SX], ca.SX]) -> "_Term":
        """Apply a linear operation."""
        return _Term(
            {j: change(slope) for j, slope in self.slopes.items()}, change(self.rest), self.moving
        )

    def plus(self, other: "_Term") -> "_Term":
        """Add another term."""
        slopes = dict(self.slopes)
        for j, slope in other.slopes.items():
            slopes[j] = slopes[j] + slope if j in slopes else slope
        slopes = {j: slope for j, slope in slopes.items() if not slope.is_zero()}
        return _Term(slopes, self.rest + other.rest, self.moving or other.moving)

    def whole(self, z: ca.SX) -> ca.SX:
        """Return the expression itself."""
        result = self.rest
        for j, slope in self.slopes.items():
            result = result + slope * z[j]
        return result


def separated(formula: ca.SX, z: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Split `formula` (k, 1) into coefficients of its linear terms (k, numel(z)), free of z, and the rest (k, 1)."""
    linear = ca.SX(formula.numel(), z.numel())
    rest = ca.SX.zeros(formula.numel())

    def operate(operation: int, terms: list[_Term]) -> _Term:
        linear_in_all = _linear_operation(operation, terms)
        if linear_in_all is not None:
            return linear_in_all
        moving = not all(term.constant for term in terms)
        return _Term({}, _apply(operation, [term.whole(z) for term in terms]), moving)

    symbols = [_Term({j: ca.SX(1)}, ca.SX(0), False) for j in range(z.numel())]
    for k, term in enumerate(walk(formula, z, symbols, lambda e: _Term({}, e, False), operate)):
        for j, slope in term.slopes.items():
            linear[k, j] = slope
        rest[k] = term.rest
    return linear, rest


def _linear_operation(operation: int, terms: list[_Term]) -> _Term | None:  # noqa: PLR0911
    """Return the result of an operation that keeps the linear form; None for others."""
    first, last = terms[0], terms[-1]
    if operation == ca.OP_ASSIGN:
        return first
    if operation == ca.OP_ADD:
        return first.plus(last)
    if operation == ca.OP_SUB:
        return first.plus(last.mapped(lambda e: -e))
    if operation == ca.OP_NEG:
        return first.mapped(lambda e: -e)
    if operation == ca.OP_TWICE:
        return first.mapped(lambda e: 2 * e)
    if operation == ca.OP_DIV and last.constant:
        return first.mapped(lambda e: e / last.rest)
    if operation == ca.OP_MUL and first.constant:
        return last.mapped(lambda e: first.rest * e)
    if operation == ca.OP_MUL and last.constant:
        return first.mapped(lambda e: e * last.rest)
    if operation == ca.OP_IF_ELSE_ZERO and first.constant:
        return last.mapped(lambda e: ca.if_else(first.rest, e, 0))
    return None


@one_thread_at_a_time
def has_switches(formula: ca.SX, z: ca.SX) -> bool:
    """Tell whether `formula` has a jump or a kink that depends on `z`."""
    return bool(_rough_switches(formula, z)[1])


@one_thread_at_a_time
def has_jumps(formula: ca.SX, z: ca.SX, moving: ca.SX) -> bool:
    """Tell whether `formula` of `z` has a jump where an expression of the signals `moving` changes its sign."""
    held, switches = _held_switches(formula, z)
    return any(
        ca.depends_on(_resolved(switch.argument, switches), moving)
        and _is_rough(held, switch, switches, z, kinks=False)
        for switch in switches
    )


def _resolved(argument: ca.SX, switches: "list[_Switch]") -> ca.SX:
    """Put the sign of an argument in place of the side of its switch, inner ones last."""
    for switch in reversed(switches):
        argument = ca.substitute(argument, switch.side, ca.if_else(switch.argument >= 0, 1, -1))
    return argument


@one_thread_at_a_time
def interval_mean(
    formula: ca.SX, z: ca.SX, slopes: ca.SX, sizes: ca.SX, interval: float
) -> tuple[ca.SX, ca.SX]:
    """Return the mean of `formula` (k, 1) over a sampling interval, and that of its product with the time from there.

    In the middle of the interval the signals are `z`, with `slopes`. A switch whose argument hardly
    moves, such as the speed in stiction, would turn at once: it takes as long as a switch whose
    signals have the slopes `sizes`. The sum of both, over equal intervals and with the end
    corrections of Euler and Maclaurin where a switch turns, is an integral of third order.
    """
    held, switches = _rough_switches(formula, z)
    slope = ca.jtimes(held, z, slopes)
    turns: list[_Turn] = []
    for switch in switches:
        argument = ca.substitute(
            switch.argument,
            _column([s.side for s in switches[: len(turns)]]),
            _column([t.now for t in turns]),
        )
        turns.append(_turn(argument, z, slopes, sizes, interval))

    mean = ca.SX.zeros(formula.numel())
    moment = ca.SX.zeros(formula.numel())
    for begin in (ca.SX(-0.5), *(turn.time for turn in turns)):
        end = ca.SX(0.5)
        sides = []
        for turn in turns:
            end = ca.if_else(turn.time > begin, ca.fmin(end, turn.time), end)
            sides.append(ca.if_else(turn.time > begin, turn.before, turn.after))
        time = interval * (begin + end) / 2
        length = ca.fmax(end - begin, 0)
        here = ca.vertcat(z + slopes * time, *sides)
        value, change = ca.substitute(
            [held, slope], [ca.vertcat(z, *[s.side for s in switches])], [here]
        )
        ends = interval / 24 * (ca.if_else(begin == -0.5, 1, 0) - ca.if_else(end == 0.5, 1, 0))
        exists = length > 0
        mean += ca.if_else(exists, length * value + ends * change, 0)
        moment += ca.if_else(exists, (length * time + ends) * value, 0)
    return mean, moment


def _column(symbols: list[ca.SX]) -> ca.SX:
    return ca.vertcat(*symbols) if symbols else ca.SX(0, 1)


@dataclass(frozen=True, eq=False)
class _Switch:
    """A switch turns where its `argument` changes sign; `side` is the symbol of that sign."""

    argument: ca.SX
    side: ca.SX


@dataclass(frozen=True, eq=False)
class _Turn:
    """The time of a turn from the middle of the interval, at most 0.5 intervals, and the sides before, after and now."""

    time: ca.SX
    before: ca.SX
    after: ca.SX
    now: ca.SX


def _turn(argument: ca.SX, z: ca.SX, slopes: ca.SX, sizes: ca.SX, interval: float) -> _Turn:
    gradient = ca.gradient(argument, z)
    slope = ca.dot(gradient, slopes)
    upward = ca.if_else(slope >= 0, 1, -1)
    least = ca.sumsqr(gradient * sizes)
    time = -argument * upward / (interval * ca.sqrt(slope**2 + least + TINY))
    now = ca.if_else(argument >= 0, 1, -1)
    turns = ca.fabs(time) < 0.5
    return _Turn(
        ca.if_else(turns, time, 0.5),
        ca.if_else(turns, -upward, now),
        ca.if_else(turns, upward, now),
        now,
    )


def _rough_switches(formula: ca.SX, z: ca.SX) -> tuple[ca.SX, list[_Switch]]:
    """Return `formula` with those switches held (`_held_switches`) where it has a jump or a kink.

    Quadratic drag ``|v| v`` has neither: samples represent it as well as a smooth formula.
    """
    held, switches = _held_switches(formula, z)
    rough = []
    for switch in reversed(switches):
        if _is_rough(held, switch, [*switches], z):
            rough.insert(0, switch)
            continue
        side = ca.if_else(switch.argument >= 0, 1, -1)
        held = ca.substitute(held, switch.side, side)
        rough = [_Switch(ca.substitute(r.argument, switch.side, side), r.side) for r in rough]
    return held, rough


def _is_rough(
    held: ca.SX, switch: _Switch, switches: list[_Switch], z: ca.SX, *, kinks: bool = True
) -> bool:
    """Tell whether `held` or its slope differs between the sides of a switch, at random points where it turns."""
    jump = ca.substitute(held, switch.side, 1) - ca.substitute(held, switch.side, -1)
    size = ca.fabs(ca.substitute(held, switch.side, 1))
    differences = ca.vertcat(jump, ca.vec(ca.jacobian(jump, z))) if kinks else jump
    sizes = ca.vertcat(size, ca.vec(ca.fabs(ca.jacobian(size, z)))) if kinks else size
    symbols = ca.symvar(ca.vertcat(held, sizes, switch.argument))
    constants = [s for s in symbols if not ca.depends_on(s, z)]
    sides = [any(ca.is_equal(s, switch.side) for switch in switches) for s in constants]
    function = ca.Function(
        "sides",
        [z, ca.vertcat(*constants)],
        [switch.argument, ca.gradient(switch.argument, z), differences, sizes],
    )
    random = np.random.default_rng(0)
    tried = 0
    for _ in range(4):
        point = random.normal(size=z.numel())
        signs = random.choice([-1.0, 1.0], len(constants))
        values = np.where(sides, signs, random.uniform(0.5, 1.5, len(constants)))
        # Newton steps to where the switch turns: a curved argument takes several.
        for _ in range(30):
            value, gradient = (np.asarray(v).ravel() for v in function(point, values)[:2])
            point = point - value * gradient / max(float(gradient @ gradient), TINY)
        value, _, difference, size = (np.asarray(ca.DM(v)).ravel() for v in function(point, values))
        if (
            not np.all(np.isfinite(np.concatenate([point, value, difference])))
            or abs(value[0]) > SAME
        ):
            continue
        tried += 1
        if np.any(np.abs(difference) > SAME * (1 + np.abs(np.nan_to_num(size)))):
            return True
    return tried == 0


def _held_switches(formula: ca.SX, z: ca.SX) -> tuple[ca.SX, list[_Switch]]:
    """Return `formula` with every switch that depends on `z` held on one side, and these switches."""
    switches: dict[int, _Switch] = {}

    def side(argument: ca.SX) -> ca.SX:
        key = argument.element_hash()
        if key not in switches:
            switches[key] = _Switch(argument, ca.SX.sym("side"))
        return switches[key].side

    def operate(operation: int, terms: list[ca.SX]) -> ca.SX:
        hold = _HELD.get(operation)
        if hold is None or not ca.depends_on(ca.vertcat(*terms), z):
            return _apply(operation, terms)
        return hold(side, *terms)

    held = ca.vertcat(*walk(formula, z, ca.vertsplit(z), lambda e: e, operate))
    return held, list(switches.values())


def walk(
    formula: ca.SX,
    z: ca.SX,
    symbols: list[Any],
    constant: Callable[[ca.SX], Any],
    operate: Callable[[int, list[Any]], Any],
) -> list[Any]:
    """Evaluate `formula` (k, 1) operation by operation, with `symbols` for z and `constant` of symbols free of z."""
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


def _apply(operation: int, terms: list[ca.SX]) -> ca.SX:
    return ca.SX.unary(operation, *terms) if len(terms) == 1 else ca.SX.binary(operation, *terms)


# --- operations while their switches are held: the side of an argument, 1 or -1, is its sign

_Side = Callable[[ca.SX], ca.SX]


def _rounded_down(side: _Side, a: ca.SX) -> ca.SX:
    nearest = ca.floor(a + 0.5)
    return nearest + (side(a - nearest) - 1) / 2


def _truncated(side: _Side, a: ca.SX) -> ca.SX:
    nearest = ca.floor(a + 0.5)
    return ca.if_else(nearest == 0, 0, nearest + (side(a - nearest) - ca.sign(nearest)) / 2)


_HELD: dict[int, Callable[..., ca.SX]] = {
    ca.OP_SIGN: lambda side, a: side(a),
    ca.OP_FABS: lambda side, a: side(a) * a,
    ca.OP_FMIN: lambda side, a, b: ca.if_else(side(b - a) > 0, a, b),
    ca.OP_FMAX: lambda side, a, b: ca.if_else(side(a - b) > 0, a, b),
    ca.OP_COPYSIGN: lambda side, a, b: side(a) * a * side(b),
    ca.OP_LT: lambda side, a, b: side(b - a) > 0,
    ca.OP_LE: lambda side, a, b: side(b - a) > 0,
    ca.OP_FLOOR: _rounded_down,
    ca.OP_CEIL: lambda side, a: -_rounded_down(side, -a),
    ca.OP_FMOD: lambda side, a, b: a - b * _truncated(side, a / b),
    ca.OP_REMAINDER: lambda side, a, b: a - b * _rounded_down(side, a / b + 0.5),
}
