"""Whether the cost has a kink at the minimum."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.engine.solve.gauss_newton.kinks import AT_KINK


def minimum_at_kink(evidence: Evidence) -> Findings:
    """Warn where the cost has a kink at the minimum."""
    search = evidence.search.found
    run = search.runs[search.minima[0].runs[0]]
    if run.status.startswith(AT_KINK):
        yield Finding(
            f"run {run.index} {run.status}: gradients beside its end differ and none is zero, as "
            "where a state or an input switches, a delay is a whole number of samples, or the "
            "steps of the integration are too long. The standard errors hold on one side only: use "
            "the profiles."
        )
