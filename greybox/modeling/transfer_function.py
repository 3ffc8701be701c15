"""Transfer functions: one input, one output, a formula in s; in series and in feedback loops."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

from greybox.modeling.model import Model, merged_parameters


class TransferFunction(Model):
    """A transfer function in s from one input to one output, e.g. equation (4.25).

    A subclass declares `input` and `output`, its parameters, and `response`. Transfer functions
    multiply: ``rotor * tilt`` is the series connection in which the signal passes `rotor` first.
    """

    input: str = "u"
    output: str = "y"

    @abstractmethod
    def response(self, s: Any, p: Any) -> Any:
        """Return the value at `s` for the parameter values `p`.

        `s` is a complex array, a `Complex` or a `Rational`; write the formula with ``+ - * / **``
        and functions such as `gb.exp`, and every reading works.
        """

    @property
    def input_names(self) -> tuple[str, ...]:
        """The one input."""
        return (self.input,)

    @property
    def output_names(self) -> tuple[str, ...]:
        """The one output."""
        return (self.output,)

    def __mul__(self, other: Any) -> "TransferFunction":
        return (
            SeriesConnection(self, other) if isinstance(other, TransferFunction) else NotImplemented
        )

    def through(self, other: "TransferFunction") -> "TransferFunction":
        """Return the series connection with a filter of the output, which keeps its name and unit.

        Raises
        ------
        TypeError
            If `other` is no transfer function.
        """
        return SeriesConnection(self, other, self.output)


class SeriesConnection(TransferFunction):
    """Series connection: the signal passes `first`, then `second`."""

    def __init__(self, first: TransferFunction, second: TransferFunction, output: str = "") -> None:
        _require_transfer_functions(first, second)
        self.first = first
        self.second = second
        self.parameters = merged_parameters((first, second))
        self.input = first.input
        self.output = output or second.output
        ends = ((first, first.input), (first if output == first.output else second, self.output))
        self.units = {name: model.units[name] for model, name in ends if name in model.units}

    @property
    def derived(self) -> Mapping[str, Callable[[Any], Any]]:  # type: ignore[override]
        """Those of both."""
        return {**self.first.derived, **self.second.derived}

    def response(self, s: Any, p: Any) -> Any:
        """Product of the two responses."""
        return self.first.response(s, p) * self.second.response(s, p)

    @property
    def label(self) -> str:
        """The names of both."""
        return f"{self.first.label} * {self.second.label}"


class FeedbackLoop(TransferFunction):
    """Closed loop forward / (1 - sign · forward · back); negative feedback with the default sign.

    A loop around a delay has exact readings in numbers and in CasADi; its rational reading needs a
    Padé approximation.
    """

    def __init__(
        self, forward: TransferFunction, back: TransferFunction | None = None, sign: int = -1
    ) -> None:
        _require_transfer_functions(forward, *(() if back is None else (back,)))
        if sign not in (-1, 1):
            raise ValueError(f"sign {sign!r} must be -1 (negative feedback) or 1.")
        self.forward = forward
        self.back = back
        self.sign = sign
        self.parameters = merged_parameters((forward,) if back is None else (forward, back))
        self.input = forward.input
        self.output = forward.output
        self.units = forward.units

    @property
    def derived(self) -> Mapping[str, Callable[[Any], Any]]:  # type: ignore[override]
        """Those of all parts."""
        return {**self.forward.derived, **(self.back.derived if self.back else {})}

    def response(self, s: Any, p: Any) -> Any:
        """Return forward over one plus the loop."""
        forward = self.forward.response(s, p)
        loop = forward if self.back is None else forward * self.back.response(s, p)
        return forward / (1 - self.sign * loop)

    @property
    def label(self) -> str:
        """The names of what is in the loop."""
        return f"Feedback({self.forward.label}" + (f", {self.back.label})" if self.back else ")")


def feedback(
    forward: TransferFunction, back: TransferFunction | None = None, sign: int = -1
) -> TransferFunction:
    """Close the loop around `forward`, through `back` if given; `sign` is that of the feedback."""
    return FeedbackLoop(forward, back, sign)


def require_no_operating_point(model: Model, at: Mapping[str, float] | None) -> None:
    """Raise ValueError where an operating point is given to a transfer function."""
    if at:
        raise ValueError(
            f"{model.label} is a transfer function and has no operating point: leave out "
            f"at={dict(at)}."
        )


def _require_transfer_functions(*models: Any) -> None:
    for model in models:
        if not isinstance(model, TransferFunction):
            raise TypeError(
                f"{model!r} is not a TransferFunction: only transfer functions can be connected."
            )
