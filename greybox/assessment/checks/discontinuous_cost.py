"""Whether the cost jumps at whole samples of a delay."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings


def discontinuous_cost(evidence: Evidence) -> Findings:
    """Warn where the cost jumps at whole samples of a delay."""
    nlp = evidence.nlp
    delays = {
        name: pair
        for part in nlp.parts
        for name, pair in part.delays.items()
        if pair[1] and name in nlp.free
    }
    for name, (input_, output) in delays.items():
        yield Finding(
            f"the held input {input_} reaches {output} directly, so the cost is discontinuous "
            f"where {name} is a whole number of samples: some start must lie in the right sample "
            f"interval, and the standard error of {name} holds within that interval."
        )
