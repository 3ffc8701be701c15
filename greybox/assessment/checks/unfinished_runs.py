"""Whether a run that did not converge was lower than the answer."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.engine.solve.minima import best_unfinished


def unfinished_runs(evidence: Evidence) -> Findings:
    """Name the run that ended at the lowest cost below the answer, but did not converge."""
    search = evidence.search.found
    best = search.minima[0].cost
    lowest = best_unfinished(search.brought)
    if lowest and lowest.cost < best:
        yield Finding(
            f"run {lowest.index} ended at a lower cost, {lowest.cost:.6g} instead of {best:.6g}, "
            f"but did not converge ({lowest.status}): give it more iterations "
            "(the option max_iter of the solver), or start there."
        )
