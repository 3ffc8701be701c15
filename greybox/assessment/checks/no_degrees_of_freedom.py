"""Whether there are more numbers than unknowns."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.files.wording import counted


def no_degrees_of_freedom(evidence: Evidence) -> Findings:
    """Warn where the data have no more numbers than the fit has unknowns."""
    nlp = evidence.nlp
    numbers = nlp.numbers
    initial = sum(part.unknown_initial_states for part in nlp.parts)
    if numbers > len(nlp.free) + initial:
        return

    states = f" and {counted(initial, 'initial state')}" if initial else ""
    leave = "leaves" if numbers == 1 else "leave"
    yield Finding(
        f"{counted(numbers, 'real number')} of data for "
        f"{counted(len(nlp.free), 'unknown')}{states} {leave} no degrees of freedom, so that no "
        "standard error is known: add data."
    )
