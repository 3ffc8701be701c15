"""Which combinations are determined although none of their members is."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.files.grouping import unique
from greybox.data.files.wording import listed


def determined_together(evidence: Evidence) -> Findings:
    """Say which combinations are determined although none of their members is."""
    fit = evidence.fit
    if not evidence.accuracy.combinations or fit.directions is None:
        return
    combinations = fit.identifiability.combinations
    if not combinations:
        return

    members = unique(name for c in combinations for name in c.names)
    remaining = f" and {len(combinations) - 3} more" if len(combinations) > 3 else ""
    yield Finding(
        f"{'; '.join(map(str, combinations[:3]))}{remaining}: determined together, although "
        f"{listed(members)} are not; the table of identifiability shows how well each "
        "is.",
        is_note=True,
    )
