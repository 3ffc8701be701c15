"""A transfer function in the limit in which one parameter goes to zero or infinity."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from greybox.data.units import to_si
from greybox.modeling.model import Names
from greybox.modeling.parameter import Parameter
from greybox.modeling.transfer_function import TransferFunction


class Limit(TransferFunction):
    """A transfer function in the limit in which a parameter goes to zero or infinity.

    Other parameters may go with it. The product or ratio that stays of each is a parameter in its
    place, such as ``a1_per_a2`` for a₁/a₂. With a₂ → ∞ and a₁/a₂ and a₃/a₂ kept,
    a₃ (s + a₄)/((s + a₄)(s + a₂) + a₁) becomes (a₃/a₂)(s + a₄)/(s + a₄ + a₁/a₂): three parameters
    instead of four.

    Parameters
    ----------
    model : TransferFunction
    name : str
        The parameter that goes to its limit.
    size : float
        Its value before the limit, with its sign.
    end : "infinity" or "zero"
    kept : sequence of (name, power, value)
        Every parameter that goes with it, as this power of the first one, and its value before.

    Raises
    ------
    ValueError
        For names that the model does not have, or has already.
    """

    def __init__(
        self,
        model: TransferFunction,
        name: str,
        size: float,
        end: str,
        kept: Sequence[tuple[str, int, float]] = (),
    ) -> None:
        self.kept = {member: int(power) for member, power, _ in kept}
        gone = (name, *self.kept)
        unknown = [member for member in gone if member not in model.parameters]
        if unknown:
            raise ValueError(
                f"{model.label} has no parameter {unknown[0]!r}; it has {', '.join(model.parameters)}."
            )
        self.model = model
        self.name = name
        self.end = end
        # Half of the digits away: what the limit leaves out and what rounding takes from it are
        # both 1e-8 of what stays.
        self.value = size * 2.0**26 if end == "infinity" else size / 2.0**26 if kept else 0.0
        self.input = model.input
        self.output = model.output
        self.units = model.units
        self.parameters = {n: p for n, p in model.parameters.items() if n not in gone}
        for member, power, value in kept:
            invariant = invariant_name(member, name, power)
            if invariant in self.parameters:
                raise ValueError(f"{model.label} has a parameter {invariant!r} already: rename it.")
            self.parameters[invariant] = _invariant(model, name, size, member, power, value)

    def values_before(self, p: Mapping[str, Any], value: float | None = None) -> dict[str, Any]:
        """Return the model's parameters where the first has a `value`, by default nearly the limit."""
        pivot = self.value if value is None else value
        values = {name: p[name] for name in self.parameters if name in self.model.parameters}
        for member, power in self.kept.items():
            values[member] = p[invariant_name(member, self.name, power)] * pivot**power
        values[self.name] = pivot
        return {name: values[name] for name in self.model.parameters}

    @property
    def label(self) -> str:
        """The model and its limit."""
        ends = "→ ∞" if self.end == "infinity" else "→ 0" if self.kept else "= 0"
        return f"{self.model.label}, {self.name} {ends}"

    def response(self, s: Any, p: Any) -> Any:
        """Return the response of the model, half of the digits before the limit."""
        return self.model.response(s, Names(self.values_before(p), self.model.label))


def invariant_name(member: str, of: str, power: int) -> str:
    """Return a name for what stays where a `member` goes as this power of another parameter."""
    times = "" if abs(power) == 1 else f"_to_{abs(power)}"
    return f"{member}_{'per' if power > 0 else 'times'}_{of}{times}"


def _invariant(
    model: TransferFunction, name: str, size: float, member: str, power: int, value: float
) -> Parameter:
    declared = model.parameters[member]
    start = value / size**power
    # A ratio a thousand times larger or smaller would be as good as infinity or zero.
    bounds = min(start / 1e3, start * 1e3), max(start / 1e3, start * 1e3)
    box = bounds
    if declared.bounds[0] < 0 < declared.bounds[1]:
        bounds = -1e3 * abs(start), 1e3 * abs(start)
        box = -3 * abs(start), 3 * abs(start)
    operator = "/" if power > 0 else "·"
    exponent = "" if abs(power) == 1 else f"^{abs(power)}"
    unit = declared.unit + f"{'/' if power > 0 else '*'}({model.parameters[name].unit})" * abs(
        power
    )
    with suppress(ValueError):  # an unknown unit stays as text
        unit = to_si(unit).si or "1"
    about = f"{member}{operator}{name}{exponent} ({declared.about or member})"
    return Parameter(start, bounds=bounds, unit=unit, about=about, starts=box)
