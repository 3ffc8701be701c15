"""Which parameters the data do not determine, or only in combination."""

import math

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.files.wording import counted, listed
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.covariance.accuracy import Accuracy
from greybox.engine.covariance.combinations import Combination
from greybox.modeling.symbolic_reading import RAMP, switching_parameters


def not_determined(evidence: Evidence) -> Findings:
    """Name the combinations that the data determine poorly or not at all, the worst three first."""
    return undetermined(evidence.accuracy)


def undetermined(accuracy: Accuracy) -> Findings:
    """Name the combinations that the data determine poorly or not at all, the worst three first."""
    absent = accuracy.nlp.noise_sizes & set(accuracy.at_bound)
    combinations = [c for c in accuracy.combinations if not set(c.names) <= absent]
    # Infinite indices first: without them fixed, no standard error exists.
    combinations.sort(key=lambda c: -c.index)
    switching = _switching(accuracy.nlp) if combinations else set()
    for combination in combinations[:3]:
        if len(combination.names) == 1 and combination.names[0] in switching:
            yield Finding(
                f"{combination.names[0]} is not determined: it enters the model only through a "
                "switch or a rounding, which has no slope that a solver could follow, so its value "
                f"is that of a start. {RAMP}"
            )
        elif math.isinf(combination.index):
            yield Finding(_not_determined(combination))
        else:
            yield Finding(
                f"{listed(combination.names)} are poorly identifiable: their effects nearly cancel "
                f"one another (collinearity index {combination.index:.0f}); fix one of them, or "
                "add data in which their effects differ."
            )

    if len(combinations) > 3:
        names = dict.fromkeys(name for c in combinations[3:] for name in c.names)
        yield Finding(
            f"{counted(len(combinations) - 3, 'more combination')} of parameters are determined "
            f"poorly or not at all, of {listed(tuple(names))}; the table of identifiability "
            "shows them."
        )


def _switching(nlp: CompiledProblem) -> set[str]:
    """Return the unknowns that the formulas contain only where they have no slope."""
    return {
        part.outside(name)
        for part in nlp.problem.parts
        for name in switching_parameters(part.model)
    }


def _not_determined(combination: Combination) -> str:
    """Name parameters without an effect, or with effects only in combination; say what to fix."""
    names, count = combination.names, combination.directions
    if len(names) == 1 and not combination.states:
        return (
            f"{names[0]} is not determined: it does not change the response to these data at this "
            "estimate. If no equation uses it, remove it; else fix it, or try starts at which it "
            "does."
        )

    cure = f"fix {names[0]}" if len(names) == 1 else f"fix {'one' if count == 1 else count} of them"
    if combination.states:
        cure += f", or give a known initial state, initial={{{combination.states[0]!r}: ...}}"

    combined = "a combination" if count == 1 else "combinations"
    return (
        f"{listed(combination.members)} are not determined: at this estimate the data depend only "
        f"on {combined} of them, so no standard error is given; {cure}."
    )
