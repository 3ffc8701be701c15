"""The number of harmonics of sine tests in a fit: as many as matter at the start values.

A fit warns if the estimate needs more, see `greybox.estimate.diagnostics.discretization`.
"""

from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum
from greybox.modeling.harmonic_balance import enough_harmonics


def with_enough_harmonics(problem: Problem | Sum[Problem]) -> Problem | Sum[Problem]:
    """Return the problem with as many harmonics as matter at the start values, if left open."""
    parts = [*problem.parts]
    for k, part in enumerate(parts):
        if part.amplitude is None or part.amplitude.harmonics:
            continue
        # The start values, not the estimate: the number of harmonics must not change during a fit.
        starts = {name: parameter.start for name, parameter in part.parameters.items()}
        values = dict(part.local_values(starts))
        omega = part.response.omega
        sine = enough_harmonics(part.model, omega, part.amplitude, values, **part.signals)
        parts[k] = part.with_(amplitude=sine)

    return problem if parts == [*problem.parts] else problem.with_parts(parts)
