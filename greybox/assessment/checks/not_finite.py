"""Whether most runs failed because the model had no finite value."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.engine.solve.not_finite import not_finite_warnings


def not_finite(evidence: Evidence) -> Findings:
    """Explain the first run that could not begin, where most runs failed."""
    for text in not_finite_warnings(evidence.nlp, evidence.search.found):
        yield Finding(text)
