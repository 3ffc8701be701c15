"""Whether a held response shows a delay, where the delayed input reaches the output at once."""

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.assessment.fitted_part import FittedResponse
from greybox.modeling.realization import dynamics
from greybox.statistics.metrics import rms


def delays_within_a_sample(evidence: Evidence) -> Findings:
    """Name held responses of outputs that a delayed input reaches at once.

    Along this path, all delays between two samples lead to the same samples: the model has the
    delay in the middle, which is off by up to half a sample.
    """
    answer = evidence.fit
    for k, (problem, part) in enumerate(zip(evidence.nlp.problem.parts, answer.parts, strict=True)):
        if not isinstance(part, FittedResponse):
            continue
        hold = problem.sampled_hold
        if not hold or not dynamics(problem.model).delayed:
            continue
        # Far above the sampling rate, this path is left, and a hundredth of any other one at most.
        path = answer.response([1e3 / hold], k).response
        shift = path * part.data.omega * hold / 2
        if np.linalg.norm(shift / part.response) > max(rms(part.relative_residuals), 0.01):
            yield Finding(
                f"the delayed input of {part.name!r} reaches its output at once. Along this "
                "path, all delays between two samples lead to the same samples: the delay is known "
                "only to half a sample, and other parameters may be biased, which the standard "
                "errors do not show. Fit the record itself."
            )
