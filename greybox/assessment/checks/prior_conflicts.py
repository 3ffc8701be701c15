"""Whether the data contradict a prior."""

import math

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.files.numbers_in_text import number, with_error


def prior_conflicts(evidence: Evidence) -> Findings:
    """Warn of parameters that the data moved further than their priors allow.

    If prior and data agree, the shift of the mean is normal, and its variance is that of the prior
    less that of the estimate. Source: Evans and Moshonov (2006), Checking for prior-data conflict,
    Bayesian Analysis 1(4), for normal densities.
    """
    fit = evidence.fit
    for name, (mean, sigma) in fit.priors.items():
        q = fit.by_name[name]
        moved = sigma**2 - q.standard_error**2
        # An error beyond that of the prior has grown with the residuals that a conflict leaves.
        spread = math.sqrt(moved) if moved > 0 else sigma
        deviations = abs(q.value - mean) / spread
        if deviations > 3:
            value, deviation = with_error(mean, sigma)
            yield Finding(
                f"the data contradict the prior of {name}, {value} ± {deviation}: the estimate "
                f"{number(q.value)} is {number(deviations, 2)} standard deviations "
                "away. Check the prior and the model."
            )
