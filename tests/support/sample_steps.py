"""The step of an integrator from one sample to the next, by itself."""

from greybox.modeling.integrators import step_function, substep_function


def stepped(system, integrator, substeps):
    return step_function(system, substep_function(system, integrator), substeps)
