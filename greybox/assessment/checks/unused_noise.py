"""Whether the criterion uses the variances or the coherence of a response, or contradicts them."""

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.files.arrays import Array
from greybox.engine.compiled.response_part import ResponsePart

# Share of the points that hold the errors, below which variances contradict a criterion: errors of
# one size are in all points, and those of two sizes, one of them small, in half.
LEAST_SHARE = 0.5


def unused_noise(evidence: Evidence) -> Findings:
    """Name responses whose variances or coherence the criterion does not use.

    That is a remark, unless the criterion assumes errors of other sizes than the variances state:
    it then gives loud points too much weight, and the intervals of few points depend on that.
    """
    problem = evidence.nlp.problem
    # In a sum with a likelihood, another criterion must be a likelihood, too.
    beside_likelihood = any(part.criterion.is_likelihood for part in problem.parts)
    values = evidence.nlp.all_values(evidence.x)
    for part in evidence.nlp.parts_of(ResponsePart):
        uses, data = part.criterion.uses, part.data
        if uses is None:
            continue
        if data.variance is not None:
            if "variance" not in uses:
                yield _of_variances(part, values, data.variance)
        elif data.coherence is not None and "coherence" not in uses and not beside_likelihood:
            text = (
                f"the coherence of {part.name!r} is not used: MagnitudePhase() weights the points "
                "by it."
            )
            yield Finding(text, "coherence", part.name, is_note=True)


def _of_variances(part: ResponsePart, values: Array, variance: Array) -> Finding:
    """Return what to say of variances (n,) that are not used: a remark, or a contradiction."""
    size = part.criterion.error_size(part.response(values), part.data)
    # Where a modeled response is zero, its errors have no size.
    ratio = variance[size > 0] / size[size > 0] ** 2
    # As many points of equal errors, beside others without any, would have this spread.
    effective = np.sum(ratio) ** 2 / max(np.sum(ratio**2), 1e-300)
    # Estimates of equal variances differ, too: the mean of their squares is larger by this factor.
    dof = part.data.dof
    scatter = 1.0 if dof is None else float(np.mean(1 + 2 / dof))

    cure = "MaximumLikelihood() weights the points by them."
    if effective * scatter >= LEAST_SHARE * len(ratio):
        text = f"the variances of {part.name!r} are not used: {cure}"
        return Finding(text, "variance", part.name, is_note=True)
    return Finding(
        f"the variances of {part.name!r} are not used, and contradict the criterion, which assumes "
        f"errors of other sizes, so that intervals may be wrong: {cure}",
        "contradiction",
        part.name,
    )
