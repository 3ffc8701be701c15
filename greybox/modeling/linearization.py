"""Linearization of an ODE about an operating point: A, B, C, D and the delays of the inputs."""

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, all_finite
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.files.printed import one_line
from greybox.data.files.public import public
from greybox.modeling.state_space import StateSpace, input_delays
from greybox.modeling.symbolic_reading import derivative_function, symbols, traced_column
from greybox.modeling.traced_once import once
from greybox.modeling.trim import trim_of


@public
@frozen
class LinearSystem:
    """``x' = A x + B u(t - delay)``, ``y = C x + D u(t - delay)`` about an operating point.

    Attributes
    ----------
    A, B, C, D : arrays (n, n), (n, m), (k, n), (k, m)
        The Jacobians.
    states, inputs, outputs : tuple of str
        Signal names, in the order of the rows and columns.
    delays : (m,) array, s
        The delay of every input.
    point : mapping of name to float
        States and inputs at the operating point.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    delays: Array
    point: Values

    def __repr__(self) -> str:
        return one_line(
            self,
            *(
                f"{kind} {', '.join(getattr(self, kind))}"
                for kind in ("states", "inputs", "outputs")
            ),
        )

    @property
    def poles(self) -> ComplexArray:
        """Eigenvalues of A, (n,), rad/s."""
        return np.linalg.eigvals(self.A).astype(complex)


@once
def jacobians(model: StateSpace) -> ca.Function:
    """Return the CasADi function (parameters, states, inputs) -> A, B, C, D."""
    n = len(model.states)
    z, p = symbols(model)
    x, u = z[:n], z[n:]
    f = derivative_function(model)(z, p)
    h = traced_column(model, "output", z, p)
    blocks = [ca.jacobian(formula, by) for formula in (f, h) for by in (x, u)]
    return ca.Function("jacobians", [p, x, u], blocks)


@public
@once
def linearize(
    model: StateSpace,
    values: Values | None = None,
    at: Values | None = None,
) -> LinearSystem:
    """Linearize `model` at the operating point `at`, by default at the declared start values.

    Raises
    ------
    ValueError
        For an unknown name, or if there is no operating point.
    """
    p = model.values(values)
    vector = list(p.values())
    x, u = trim_of(model, at or {}).closed()(vector)
    point = np.asarray(ca.vertcat(x, u)).ravel()
    # Without an operating point, `trim_of` returns an infinite one, so that a search can continue.
    if not all_finite(point):
        raise ValueError(
            f"{model.label} has no operating point with {dict(at or {})} at {dict(p)}: check `at` "
            "and the values."
        )

    return LinearSystem(
        *[matrix.full() for matrix in jacobians(model)(vector, x, u)],
        states=model.state_names,
        inputs=model.input_names,
        outputs=model.output_names,
        delays=np.array([*input_delays(model, p).values()], dtype=float),
        point=dict(zip(model.resting_signals, point.tolist(), strict=True)),
    )
