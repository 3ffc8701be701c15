"""Whether values that an earlier fit holds have an error."""

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.files.wording import listed


def held_without_error(evidence: Evidence) -> Findings:
    """Name values fixed at an earlier fit that gives them no standard error."""
    nlp = evidence.nlp
    variances = np.diag(evidence.accuracy.covariance)[len(nlp.free) :]
    held = nlp.problem.held_estimates
    pairs = zip(nlp.constants, variances, strict=True)
    unknown = [name for name, variance in pairs if name in held and np.isnan(variance)]
    if unknown:
        yield Finding(
            f"the earlier fit gives {listed(unknown)} no standard error, so none can be given "
            "here; fix it at a number to treat it as known."
        )
