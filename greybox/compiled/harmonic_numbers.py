"""The number of harmonics of sine tests in a fit: as many as matter at the start values.

A fit warns if the estimate needs more, see `greybox.estimate.diagnostics.harmonics`.
"""

from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum
from greybox.modeling.harmonic_balance import enough_harmonics


def with_enough_harmonics(problem: Problem | Sum[Problem]) -> Problem | Sum[Problem]:
    """Return the problem with as many harmonics as matter at the start values, if left open."""
    parts = [_with_enough(part) for part in problem.parts]
    return problem if parts == [*problem.parts] else problem.with_parts(parts)


def _with_enough(part: Problem) -> Problem:
    if part.amplitude is None or part.amplitude.harmonics:
        return part
    # The start values, not the estimate: the number of harmonics must not change during a fit.
    starts = {name: parameter.start for name, parameter in part.parameters.items()}
    sine = enough_harmonics(
        part.model,
        part.response.omega,
        part.amplitude,
        dict(part.local_values(starts)),
        **part.signals,
    )

    return part.with_(amplitude=sine)
