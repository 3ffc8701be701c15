"""The equations of a record, which may lack terms."""

from dataclasses import dataclass

import casadi as ca

from greybox.engine.compiled.record_part import RecordPart
from greybox.modeling.colored_disturbance import undisturbed
from greybox.modeling.traced_once import once

# States and inputs beyond which an equation is tried with its own alone: with twenty states, the
# products of all pairs in all equations are thousands of terms, among which a true one is not
# found.
LARGE = 10


@dataclass(frozen=True)
class Equation:
    """The signals in the derivative of a state, and those among them with a parameter."""

    index: int
    state: str
    signals: frozenset[str]
    present: frozenset[str]


@once  # of constants, of other terms, and of a warning
def dynamic_equations(part: RecordPart) -> list[Equation]:
    """Return the equations of a record that may lack a term.

    In a small model all states and inputs count as being in every derivative. Derivatives without
    any parameter or input are kinematic, and left out unless all are; those of colored disturbances
    are left out, too.
    """
    system = part.system
    x, u, p = system.symbols
    names = (*system.states, *system.inputs)
    derivative = system.derivative(x, u, p)
    slopes = ca.jacobian(derivative, ca.vertcat(x, u))
    is_in_equation = slopes.sparsity()

    own = range(len(undisturbed(part.problem.model).state_names) or len(system.states))
    dynamic = [i for i in own if ca.depends_on(derivative[i], ca.vertcat(u, p))]
    equations = []
    for i in dynamic or own:
        signals, present = set[str](), set[str]()
        for k, name in enumerate(names):
            if len(names) <= LARGE or is_in_equation.has_nz(i, k):
                signals.add(name)
            if ca.depends_on(slopes[i, k], p):
                present.add(name)
        equations.append(Equation(i, system.states[i], frozenset(signals), frozenset(present)))
    return equations
