"""Whether the integration is accurate enough for the noise."""

import math

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.engine.solve.discretization_error import discretization_error


def coarse_integration(evidence: Evidence) -> Findings:
    """Warn where twice the number of steps would move the estimate noticeably."""
    nlp = evidence.nlp
    count = nlp.substeps
    if not count:
        return

    error = evidence.search.error or discretization_error(nlp, evidence.accuracy.trajectories)
    if not error.matters:
        return

    # The parameter that moves most, in standard errors: one name is enough to act.
    name = nlp.free[np.argmax(np.abs(error.shift))]
    size = "without limit, since the model diverges"
    if math.isfinite(error.largest):
        size = f"by {error.largest:.2g} standard errors"

    yield Finding(
        f"the integration is too coarse: twice the steps per sample ({2 * count} instead of "
        f"{count}) would change {name} or its standard error {size}; "
        f"use {nlp.method.finer(error.growth * count)}{nlp.method.other_cure}."
    )
