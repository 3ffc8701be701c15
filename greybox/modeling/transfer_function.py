"""Transfer functions: one input, one output, a formula in s; in series and in feedback loops."""

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

from greybox.data.files.public import public
from greybox.modeling.formula_arguments import Names
from greybox.modeling.merged_parameters import merged_parameters
from greybox.modeling.model import Model, ParameterFormula, require_known


class TransferFunction(Model):
    """A transfer function in s from one input to one output, e.g. equation (4.25).

    A subclass declares `input` and `output`, its parameters, and `response`. Transfer functions
    multiply: ``rotor * tilt`` is the series connection in which the signal passes `rotor` first. A
    name that both use for a parameter is either changed or declared shared, see `series`.

    Examples
    --------
    >>> class Lag(gb.TransferFunction):
    ...     K = gb.Parameter(1.0, bounds=(0, 10))
    ...     T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s")
    ...
    ...     def response(self, s, p):
    ...         return p.K / (p.T * s + 1) * gb.exp(-0.02 * s)
    >>> at_corner = gb.frequency_response(Lag(), {"K": 2.0, "T": 0.5}, omega=[2.0])
    >>> abs(at_corner.response).round(4)
    array([1.4142])
    """

    input: str = "u"
    output: str = "y"

    @abstractmethod
    def response(self, s: Any, p: Any) -> Any:
        """Return the value at `s` for the parameter values `p`.

        `s` is a complex array, a `Complex` or a `Rational`: write the formula with ``+ - * / **``
        and functions such as `gb.exp`, which work for all of these.
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
        return self.series(other) if isinstance(other, TransferFunction) else NotImplemented

    def series(self, other: "TransferFunction", shared: Sequence[str] = ()) -> "TransferFunction":
        """Return the series connection ``self * other``, in which `shared` parameters are one.

        Raises
        ------
        TypeError
            If `other` is not a transfer function.
        ValueError
            If both have a parameter with the same name that is not `shared`.
        """
        return SeriesConnection(self, other, shared=tuple(shared))

    def through(self, other: "TransferFunction") -> "TransferFunction":
        """Return the series connection with a filter of the output, which keeps its name and unit.

        Raises
        ------
        TypeError, ValueError
            As for `series`.
        """
        return SeriesConnection(self, other, self.output)

    def renamed(self, **names: str) -> "TransferFunction":
        """Return the model with other names of parameters, ``Tilt().renamed(T_delay="T_tilt")``.

        Raises
        ------
        ValueError
            For a parameter that does not exist, or a name that is in use.
        """
        return RenamedParameters(self, *names.items())


class RenamedParameters(TransferFunction):
    """A transfer function with other names of parameters, see `TransferFunction.renamed`."""

    def __init__(self, model: TransferFunction, *pairs: tuple[str, str]) -> None:
        _require_transfer_functions(model)
        names = dict(pairs)
        require_known(names, model.parameters, "parameter", model.label)
        self.model = model
        self.names = {name: names.get(name, name) for name in model.parameters}
        self.parameters = {self.names[name]: value for name, value in model.parameters.items()}
        if len(self.parameters) < len(model.parameters):
            raise ValueError(f"{model.label} would have two equally named parameters: {names}.")
        self.input = model.input
        self.output = model.output
        self.units = model.units

    def _inside(self, p: Any) -> Names:
        return Names({name: p[new] for name, new in self.names.items()}, self.label)

    @property
    def derived(self) -> Mapping[str, ParameterFormula]:  # type: ignore[override]
        """Derived quantities of the model, under their own names."""
        quantities = self.model.derived.items()
        # The default binds each function now; the loop variable would be the last one.
        return {name: lambda p, f=f: f(self._inside(p)) for name, f in quantities}

    def response(self, s: Any, p: Any) -> Any:
        """Return the response of the model."""
        return self.model.response(s, self._inside(p))

    @property
    def label(self) -> str:
        """Name of the model."""
        return self.model.label


class Connection(TransferFunction):
    """Transfer functions that work together; a parameter that several have is one unknown."""

    def __init__(self, *parts: TransferFunction) -> None:
        _require_transfer_functions(*parts)
        self.parts = parts
        self.parameters = merged_parameters(parts)
        self.input = parts[0].input
        self.output = parts[0].output
        self.units = parts[0].units

    @property
    def derived(self) -> Mapping[str, ParameterFormula]:  # type: ignore[override]
        """Derived quantities of all parts."""
        return {name: f for part in self.parts for name, f in part.derived.items()}


class SeriesConnection(Connection):
    """Series connection: the signal passes `first`, then `second`.

    A parameter that both have, such as a delay, acts twice. So it must be declared `shared`.
    """

    def __init__(
        self,
        first: TransferFunction,
        second: TransferFunction,
        output: str = "",
        shared: Sequence[str] = (),
    ) -> None:
        _require_transfer_functions(first, second)
        # If shared silently, the delay of a rotor would act once more as the delay of the airframe.
        for name in first.parameters:
            if name in second.parameters and name not in shared:
                raise ValueError(
                    f"{first.label} and {second.label} both have {name!r}: rename one of them, "
                    f".renamed({name}='{name}_2'), or, if it is the same quantity in both, use "
                    f".series(..., shared=[{name!r}])."
                )

        super().__init__(first, second)
        self.output = output or second.output
        # A filter does not change the unit of the output.
        ends = ((first, first.input), (first if output == first.output else second, self.output))
        self.units = {name: model.units[name] for model, name in ends if name in model.units}

    def response(self, s: Any, p: Any) -> Any:
        """Return the product of the two responses."""
        first, second = self.parts
        return first.response(s, p) * second.response(s, p)

    @property
    def label(self) -> str:
        """Names of both."""
        return " * ".join(part.label for part in self.parts)


class FeedbackLoop(Connection):
    """Closed loop forward / (1 - sign · forward · back); negative feedback with the default sign.

    A loop around a delay has exact readings in numbers and in CasADi; its rational reading needs a
    Padé approximation.
    """

    def __init__(self, forward: TransferFunction, back: TransferFunction | None, sign: int) -> None:
        if sign not in (-1, 1):
            raise ValueError(f"sign {sign!r} must be -1 (negative feedback) or 1.")
        super().__init__(forward, *(() if back is None else (back,)))
        self.sign = sign

    def response(self, s: Any, p: Any) -> Any:
        """Return forward over one plus the loop."""
        forward, *back = (part.response(s, p) for part in self.parts)
        return forward / (1 - self.sign * math.prod(back, start=forward))

    @property
    def label(self) -> str:
        """Names of the parts."""
        return f"Feedback({', '.join(part.label for part in self.parts)})"


@public
def feedback(
    forward: TransferFunction, back: TransferFunction | None = None, sign: int = -1
) -> TransferFunction:
    """Close the loop around `forward`, through `back` if given; `sign` is that of the feedback.

    Examples
    --------
    >>> from greybox.models.filters import FirstOrderLowPass
    >>> loop = gb.feedback(FirstOrderLowPass(10.0))
    >>> values = {name: parameter.start for name, parameter in loop.parameters.items()}
    >>> abs(gb.frequency_response(loop, values, omega=[1e-3]).response).round(3)
    array([0.5])
    """
    return FeedbackLoop(forward, back, sign)


def _require_transfer_functions(*models: Any) -> None:
    for model in models:
        if not isinstance(model, TransferFunction):
            raise TypeError(
                f"{model!r} is not a TransferFunction: only transfer functions can be connected."
            )
