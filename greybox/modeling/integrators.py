"""From one sample to the next: fixed-step integrators, compiled as one CasADi function.

Within a step the inputs are linear in time, u(t) = mean + slope · (t / step - 1/2), which holds
both a held and an interpolated input, delayed by any fraction of a step (see
`greybox.compiled.sampled_data`).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.realization import Dynamics


@dataclass(frozen=True)
class Integrator(ABC):
    """A scheme with `substeps` equal steps from one sample to the next.

    With None, `greybox.compiled.step_size` chooses their number.

    Attributes
    ----------
    order : int
        The error of one step falls with its (order + 1)th power.
    reach : float
        Largest |pole| · step for which a step is stable.
    wave : float
        Largest |imaginary part of a pole| · step at which an oscillation is followed closely enough
        at first. At 0.7, a Runge-Kutta step changes the amplitude by 0.7⁶ / 144 and the phase by
        0.7⁵ / 120, 0.7 % and 0.013 rad in a period; the data then decide whether this matters.
    implicit : bool
        True if a step solves equations by iteration, which CasADi expresses in MX only.
    """

    substeps: int | None = None
    order: ClassVar[int]
    reach: ClassVar[float]
    wave: ClassVar[float] = 0.7
    implicit: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Check the number of substeps."""
        if self.substeps is not None and (not isinstance(self.substeps, int) or self.substeps < 1):
            raise ValueError(
                f"substeps {self.substeps!r} must be a whole number of at least 1, or None for an "
                "automatic choice."
            )

    @property
    def name(self) -> str:
        """Name for users."""
        return type(self).__name__

    @abstractmethod
    def advance(self, system: Dynamics, x: Any, u: Any, slope: Any, p: Any, h: Any) -> Any:
        """Return x (n,) one step h later, from u (m,) at its beginning and their slope (m,)."""


@dataclass(frozen=True)
class RungeKutta(Integrator):
    """The classical explicit method of order four (Hairer, Nørsett, Wanner, volume I, II.1)."""

    order = 4
    # The stability region ends at -2.785 on the real and 2.828 j on the imaginary axis.
    reach = 2.7
    name: ClassVar[str] = "RK4"  # type: ignore[misc]

    def advance(self, system: Dynamics, x: Any, u: Any, slope: Any, p: Any, h: Any) -> Any:
        """Return x one step later."""
        middle = u + slope * h / 2
        end = u + slope * h
        k1 = system.derivative(x, u, p)
        k2 = system.derivative(x + h / 2 * k1, middle, p)
        k3 = system.derivative(x + h / 2 * k2, middle, p)
        k4 = system.derivative(x + h * k3, end, p)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@one_thread_at_a_time
def substep_function(system: Dynamics, integrator: Integrator) -> ca.Function:
    """Return (x, u, slope, p, h) -> x one step h later, from u (m,) at its beginning.

    Explicit schemes see inputs that are delayed by states as lines, too, see `pade_step`; implicit
    ones integrate these states.
    """
    kind: Any = ca.MX if integrator.implicit else ca.SX
    x, u = kind.sym("x", len(system.states)), kind.sym("u", len(system.inputs))
    slope, h = kind.sym("slope", len(system.inputs)), kind.sym("h")
    p = kind.sym("p", len(system.parameters))

    undelayed = None if integrator.implicit else system.undelayed
    driven = undelayed or system
    result, late = ca.vertsplit(x, [0, len(driven.states), len(system.states)])
    acting, ramp = u, slope
    if undelayed:
        late, acting, ramp = system.delay_step(late, u, slope, p, h)
    result = integrator.advance(driven, result, acting, ramp, p, h)
    options = {"always_inline": True} if integrator.implicit else {}
    return ca.Function("substep", [x, u, slope, p, h], [ca.vertcat(result, late)], options)


@one_thread_at_a_time
def step_function(
    system: Dynamics, integrator: Integrator, substeps: int, substep: ca.Function | None = None
) -> ca.Function:
    """Return (x, mean, change, p, step) -> x one sample later.

    `mean` and `change` (m,) are those of the inputs over the step. The `substep` of the integrator
    is made here if it is not given.
    """
    substep = substep or substep_function(system, integrator)
    # Copies of many operations take longer to compile than calls of one function to evaluate. A rod
    # of 20 cells has 7000 in nine substeps: half a second to compile and to differentiate.
    repeated = not integrator.implicit and substep.n_instructions() * substeps > 5000
    kind: Any = ca.MX if integrator.implicit or repeated else ca.SX
    x = kind.sym("x", len(system.states))
    p = kind.sym("p", len(system.parameters))
    h = kind.sym("h")
    mean = kind.sym("mean", len(system.inputs))
    change = kind.sym("change", len(system.inputs))

    end = x
    for k in range(substeps if system.states else 0):
        # The input at the beginning of the substep; `change` is that over the whole step.
        u = mean + change * (k / substeps - 0.5)
        end = substep(end, u, change / h, p, h / substeps)

    return ca.Function("step", [x, mean, change, p, h], [end], {"cse": True})
