"""Whether outputs jump by a full turn where the fitted ones do not."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.assessment.wrapped_outputs import wrapped


def wrapped_outputs(evidence: Evidence) -> Findings:
    """Name measured angles that are to be unwrapped."""
    for text in wrapped(evidence.fit):
        yield Finding(text)
