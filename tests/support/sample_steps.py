"""The step of an integrator from one sample to the next, by itself."""

import casadi as ca

from greybox.modeling.integrators import repeated, substep_function


def stepped(system, integrator, substeps):
    kind = ca.MX if integrator.implicit else ca.SX
    sizes = (
        len(names)
        for names in (system.states, system.inputs, system.inputs, system.parameters, "h")
    )
    symbols = [kind.sym("v", size) for size in sizes]
    end = repeated(substep_function(system, integrator), substeps, *symbols)
    return ca.Function("step", symbols, [end])
