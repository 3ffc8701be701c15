"""A structure with one of its parameters at zero or beyond all bounds, and what goes with it kept in proportion."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from greybox.data.units import SUPERSCRIPTS, to_si
from greybox.modeling.model import Model, Names
from greybox.modeling.parameter import Parameter
from greybox.modeling.state_space import StateSpace
from greybox.modeling.transfer_function import TransferFunction

# Of the size that the parameter had: half of the digits, so that what the limit leaves out and what
# rounding takes from it are both 1e-8 of what is kept.
BEYOND = 2.0**26

# Bounds of a ratio, times its first value: what would be as good as zero or infinity beside it.
SPAN = 1e3


class _AtLimit(Model):
    """A structure in the limit in which a parameter goes to zero or infinity.

    Others may go with it: of each the product or ratio that stays is a parameter in its place, such
    as ``a1_per_a2`` for a₁/a₂. With a₂ → ∞ and a₁/a₂ and a₃/a₂ kept, a₃ (s + a₄)/((s + a₄)(s + a₂)
    + a₁) becomes (a₃/a₂)(s + a₄)/(s + a₄ + a₁/a₂): three parameters instead of four.

    Parameters
    ----------
    model : TransferFunction or StateSpace
    name : str
        The parameter that goes to its limit.
    size : float
        Its value before, with its sign.
    end : "infinity" or "zero"
    kept : sequence of (name, power, value)
        What goes with it: the parameter, by which power of the first, and its value before.

    Raises
    ------
    ValueError
        For names that the model does not have.
    """

    def __init__(
        self,
        model: Any,
        name: str,
        size: float,
        end: str,
        kept: Sequence[tuple[str, int, float]] = (),
    ) -> None:
        for known in (name, *(member for member, _, _ in kept)):
            if known not in model.parameters:
                raise ValueError(
                    f"{model.label} has no parameter {known!r}; it has {', '.join(model.parameters)}."
                )
        if end not in ("infinity", "zero"):
            raise ValueError(f"end is {end!r}: give 'infinity' or 'zero'.")
        self.model = model
        self.name = name
        self.end = end
        self.kept = {member: int(power) for member, power, _ in kept}
        self.value = size * BEYOND if end == "infinity" else size / BEYOND if kept else 0.0
        self.units = model.units
        self.parameters = {
            known: p for known, p in model.parameters.items() if known not in (name, *self.kept)
        }
        for member, power, value in kept:
            invariant = invariant_name(member, name, power)
            if invariant in self.parameters:
                raise ValueError(f"{model.label} has a parameter {invariant!r} already: rename it.")
            self.parameters[invariant] = _invariant(model, name, size, member, power, value)

    @property
    def derived(self) -> Mapping[str, Callable[[Any], Any]]:  # type: ignore[override]
        """Those of what is left."""
        values = Names({name: p.start for name, p in self.parameters.items()})
        return {
            name: function
            for name, function in self.model.derived.items()
            if _is_defined(function, values)
        }

    def values_before(self, p: Mapping[str, Any], value: float | None = None) -> dict[str, Any]:
        """Return the values of the model's parameters where the first has a `value`, by default that of the limit."""
        pivot = self.value if value is None else value
        given = {name: p[name] for name in self.parameters if name in self.model.parameters}
        for member, power in self.kept.items():
            given[member] = p[invariant_name(member, self.name, power)] * pivot**power
        return {name: pivot if name == self.name else given[name] for name in self.model.parameters}

    @property
    def label(self) -> str:
        """The structure and what goes where."""
        return f"{self.model.label}, {self.name} {'→ ∞' if self.end == 'infinity' else '→ 0' if self.kept else '= 0'}"

    def _before(self, p: Mapping[str, Any]) -> Names:
        return Names(self.values_before(p), self.model.label)


class Limit(_AtLimit, TransferFunction):  # type: ignore[misc]
    """A transfer function in the limit in which a parameter goes to zero or infinity, see `at_limit`."""

    def __init__(self, model: TransferFunction, *limit: Any) -> None:
        super().__init__(model, *limit)
        self.input, self.output = model.input, model.output

    def response(self, s: Any, p: Any) -> Any:
        """Return that of the model, half of the digits before the limit."""
        return self.model.response(s, self._before(p))


class StateSpaceLimit(_AtLimit, StateSpace):  # type: ignore[misc]
    """An ODE or a static model in the limit in which a parameter goes to zero or infinity, see `at_limit`."""

    def __init__(self, model: StateSpace, *limit: Any) -> None:
        super().__init__(model, *limit)
        self.states, self.inputs, self.outputs = model.states, model.inputs, model.outputs
        gone = {self.name, *self.kept}
        if any(name in gone for name in model.delays.values()) and (
            self.kept or self.end == "infinity"
        ):
            raise ValueError(
                f"{self.name} delays an input of {model.label}: a delay can go to zero alone."
            )
        self.delays = {signal: name for signal, name in model.delays.items() if name not in gone}

    def derivative(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return that of the model at the limit."""
        return self.model.derivative(x, u, self._before(p))

    def output(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return that of the model at the limit."""
        return self.model.output(x, u, self._before(p))

    @property
    def trim(self) -> Any:  # type: ignore[override]
        """That of the model, where it has one."""
        return None if self.model.trim is None else self._trim

    def _trim(self, at: Any, p: Any) -> Mapping[str, Any]:
        return self.model.trim(at, self._before(p))


def at_limit(
    model: Model, name: str, size: float, end: str, kept: Sequence[tuple[str, int, float]] = ()
) -> Model:
    """Return a structure in the limit in which a parameter goes to zero or infinity.

    Raises
    ------
    ValueError
        For names that the model does not have, and a delay that goes elsewhere than to zero.
    """
    kind: Any = Limit if isinstance(model, TransferFunction) else StateSpaceLimit
    return kind(model, name, size, end, kept)


def invariant_name(member: str, of: str, power: int) -> str:
    """Return a name for what stays where a `member` goes as this power of another parameter."""
    times = {1: "", 2: "_squared", 3: "_cubed"}.get(abs(power), f"_to_{abs(power)}")
    return f"{member}_{'per' if power > 0 else 'times'}_{of}{times}"


def _invariant(
    model: Model, name: str, size: float, member: str, power: int, value: float
) -> Parameter:
    declared, other = model.parameters[member], model.parameters[name]
    start = value / size**power
    reach = SPAN * abs(start)
    low, high = (
        (-reach, reach)
        if declared.bounds[0] < 0 < declared.bounds[1]
        else sorted((start / SPAN, start * SPAN))
    )
    box = (-3 * abs(start), 3 * abs(start)) if low < 0 < high else (low, high)
    operator = f"{member}/{name}" if power > 0 else f"{member}·{name}"
    return Parameter(
        start,
        bounds=(low, high),
        unit=_unit(declared.unit, other.unit, power),
        about=f"{operator}{_exponent(abs(power))} ({declared.about or member})",
        starts=box,
    )


def _exponent(power: int) -> str:
    return "" if power == 1 else "".join(SUPERSCRIPTS[int(digit)] for digit in str(power))


def _unit(one: str, other: str, power: int) -> str:
    """Return the unit of a member over a power of another one, as text where it is not a known one."""
    text = one
    for _ in range(abs(power)):
        text = f"{text}{'/' if power > 0 else '*'}({other})"
    try:
        return to_si(text).si or "1"
    except ValueError:
        return text


def _is_defined(function: Callable[[Any], Any], values: Names) -> bool:
    try:
        return math.isfinite(function(values))
    except (AttributeError, KeyError, ArithmeticError):
        return False
