"""Whether the model explains the data."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings


def unexplained(evidence: Evidence) -> Findings:
    """Say what it means for the values that the model does not explain the data."""
    if not evidence.is_explained:
        yield Finding(
            "the model does not explain the data, so its estimates may be biased, and the standard "
            "errors would be valid only if it did."
        )
