"""A model at its estimate as a CasADi function, for control and estimators."""

from typing import Any

import casadi as ca

from greybox.data.files.named_values import Values
from greybox.data.files.public import public
from greybox.reporting.interop.linear_systems import given_model


@public
def to_casadi(
    thing: Any,
    values: Values | None = None,
    *,
    pade: int | None = None,
    part: int = 0,
) -> ca.Function:
    """Return ``(x, u) -> (derivative, y)`` of a model at its estimate as a `casadi.Function`.

    A transfer function has the states of its observer canonical form. States, inputs and outputs
    are in the order of the model.

    Parameters
    ----------
    thing : Fit or Model
    values : mapping of name to float, optional
        Values of a model's parameters, by default the declared starts.
    pade : int, optional
        Order of the Padé approximation of delays, which the function cannot hold; 0 leaves delays
        out.
    part : int
        Part of a fit.

    Raises
    ------
    ValueError, TypeError
        For a delay without `pade`, or what cannot be converted.

    Examples
    --------
    >>> import greybox as gb
    >>> from greybox.models.tilt import LinearTilt
    >>> f = gb.interop.to_casadi(LinearTilt(), {"a1": -14.6}, pade=2)
    >>> derivative, y = f([0] * f.size1_in(0), 0.1)
    """
    source = given_model(thing, values, None, part)
    system, p = source.ode(pade)
    x, u, _ = system.symbols
    outputs = [system.derivative(x, u, p), system.output(x, u, p)]
    # CasADi accepts only names of letters, digits and single underscores.
    name = ca.Function.fix_name(source.model.label)
    return ca.Function(name, [x, u], outputs, ["x", "u"], ["derivative", "y"])
