"""Fixed-step integrators from one sample to the next, compiled as one CasADi function.

Within a step the inputs are linear in time, u(t) = mean + change · (t / step - 1/2). This form
covers zero-order-hold and interpolated inputs that are delayed by any fraction of a step (see
`greybox.engine.compiled.sampled_data`).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from greybox.data.files.argument_checks import require_whole
from greybox.data.files.public import public
from greybox.modeling.realization import Dynamics
from greybox.modeling.traced_once import once


@public
@dataclass(frozen=True)
class Integrator(ABC):
    """A scheme with `substeps` equal steps from one sample to the next.

    If `substeps` is None, `greybox.engine.compiled.step_size` chooses the number of steps.

    Attributes
    ----------
    order : int
        The error of one step is proportional to the (order + 1)th power of its length.
    reach : float
        Largest |pole| · step for which a step is stable.
    wave : float
        Largest |imaginary part of a pole| · step, in rad, of the first choice of the step. At 0.7,
        a Runge-Kutta step changes the amplitude of an oscillation by 0.7⁶ / 144 and its phase by
        0.7⁵ / 120. In a period these are 0.7 % and 0.013 rad. The step is refined if the data need
        it.
    implicit : bool
        True if a step solves equations by iteration, which CasADi expresses in MX only.

    Examples
    --------
    >>> [isinstance(i, gb.Integrator) for i in (gb.RungeKutta(), gb.Radau())]
    [True, True]
    """

    substeps: int | None = None
    order: ClassVar[int]
    reach: ClassVar[float]
    wave: ClassVar[float] = 0.7
    implicit: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Check the number of substeps."""
        if self.substeps is not None:
            require_whole("substeps", self.substeps, 1)

    @property
    def name(self) -> str:
        """Name for users."""
        return type(self).__name__

    @abstractmethod
    def advance(self, system: Dynamics, x: Any, u: Any, slope: Any, p: Any, h: Any) -> Any:
        """Return x (n,) one step h later, from u (m,) at its beginning and their slope (m,)."""


@public
@dataclass(frozen=True)
class RungeKutta(Integrator):
    """The classical explicit method of order four (Hairer, Nørsett, Wanner, volume I, II.1).

    Examples
    --------
    >>> from greybox.models.tilt import LinearTilt
    >>> record = gb.Record(np.arange(100) / 100, {"u": np.ones(100)})
    >>> moved = gb.simulate(LinearTilt(), record=record, integrator=gb.RungeKutta(substeps=2))
    >>> len(moved)
    100
    """

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


@once
def substep_function(system: Dynamics, integrator: Integrator) -> ca.Function:
    """Return (x, u, slope, p, h) -> x one step h later, from u (m,) at its beginning.

    Some states may belong to delays of inputs. Explicit schemes advance these states exactly and
    take the delayed inputs as linear in time, see `pade_step`. Implicit schemes integrate them with
    the other states.
    """
    kind: Any = ca.MX if integrator.implicit else ca.SX
    x = kind.sym("x", len(system.states))
    u = kind.sym("u", len(system.inputs))
    slope = kind.sym("slope", len(system.inputs))
    h = kind.sym("h")
    p = kind.sym("p", len(system.parameters))

    undelayed = None if integrator.implicit else system.undelayed
    plant = undelayed or system
    plant_states, delay_states = ca.vertsplit(x, [0, len(plant.states), len(system.states)])
    plant_input = u
    input_slope = slope
    if undelayed:
        delay_states, plant_input, input_slope = system.delay_step(delay_states, u, slope, p, h)
    plant_states = integrator.advance(plant, plant_states, plant_input, input_slope, p, h)
    # CasADi divides many derivatives of a called function into groups, each of which would repeat
    # the steps of an implicit scheme.
    options = {"always_inline": integrator.implicit}
    return ca.Function(
        "substep", [x, u, slope, p, h], [ca.vertcat(plant_states, delay_states)], options
    )


def repeated(substep: Any, substeps: int, x: Any, mean: Any, change: Any, p: Any, h: Any) -> Any:
    """Return x one sample later, after `substeps` steps of a `substep_function`.

    `mean` (m,) is the mean of the inputs over the sampling interval h, and `change` (m,) is their
    change from its beginning to its end.
    """
    slope = change / h
    length = h / substeps
    for k in range(substeps):
        # The input at the beginning of the substep: at the middle of the interval it is the mean.
        u = mean + change * (k / substeps - 0.5)
        x = substep(x, u, slope, p, length)
    return x
