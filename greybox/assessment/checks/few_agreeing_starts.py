"""Whether enough starts agree on the best minimum."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings


def few_agreeing_starts(evidence: Evidence) -> Findings:
    """Warn where fewer than a tenth of the starts reached the best minimum, or most runs failed."""
    search, agreeing = evidence.search.found, evidence.fit.agreeing
    count = len(search.brought)
    if not agreeing:  # as `agreeing_runs` counts where the best is a response of zero
        yield Finding(
            f"the model explains nothing: the cost {search.minima[0].cost:.6g} is that of a "
            "response of zero; narrow the start boxes or the bounds, or use more starts."
        )
        return
    if len(search.runs) == 1:
        yield Finding("one start only: another minimum may be lower; use more starts.")
    elif agreeing == 1 or agreeing < count / 10:
        yield Finding(
            f"only {agreeing} of {count} starts reached the best minimum: a better one may exist; "
            "use more starts."
        )

    if search.converged < count / 2:
        yield Finding(f"only {search.converged} of {count} runs converged ({search.failures}).")
