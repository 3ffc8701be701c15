"""Whether the criterion uses the variances or the coherence of a response."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.frequency_response import FrequencyResponse


def unused_noise(evidence: Evidence) -> Findings:
    """Note responses whose variances or coherence the criterion does not use."""
    problem = evidence.nlp.problem
    # In a sum with a likelihood, another criterion must be a likelihood, too.
    beside_likelihood = any(part.criterion.is_likelihood for part in problem.parts)
    for part in problem.parts_with(FrequencyResponse):
        uses, data = part.criterion.uses, part.data
        if uses is None:
            continue
        if data.variance is not None:
            if "variance" not in uses:
                text = (
                    f"the variances of {part.name!r} are not used: MaximumLikelihood() weights the "
                    "points by them."
                )
                yield Finding(text, "variance", part.name, is_note=True)
        elif data.coherence is not None and "coherence" not in uses and not beside_likelihood:
            text = (
                f"the coherence of {part.name!r} is not used: MagnitudePhase() weights the points "
                "by it."
            )
            yield Finding(text, "coherence", part.name, is_note=True)
