"""Whether a point of a response is an outlier."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.assessment.largest_deviation import SIZE, largest_deviation
from greybox.data.files.numbers_in_text import number, percent
from greybox.engine.compiled.response_part import ResponsePart


def outlying_points(evidence: Evidence) -> Findings:
    """Name points far from the model: outliers, or what a wrong model misses.

    In 71 of 144 fits of wrong models without outliers there was such a point, mostly the last.
    """
    if evidence.is_exact:
        return

    nlp = evidence.nlp
    values = nlp.all_values(evidence.x)
    responses = nlp.parts_of(ResponsePart)
    points = sum(len(part.data) for part in responses)
    for part in responses:
        deviation = largest_deviation(part, values, len(nlp.free))
        if deviation and points * deviation.probability < SIZE:
            omega = part.data.omega[deviation.index]
            one_in = number(1 / max(points * deviation.probability, 1e-12), 2)
            yield Finding(
                f"the point at {omega:.4g} rad/s of {part.name!r} is "
                f"{percent(deviation.relative)} % from the model: fewer than one in {one_in} fits "
                "to clean data have such a point. It is an outlier, or the model lacks something "
                "there: fit again without it to see its effect."
            )
