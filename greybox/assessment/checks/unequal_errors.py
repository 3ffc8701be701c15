"""Whether the errors of a response are larger in a part of the band than assumed."""

import math

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.assessment.largest_deviation import ROUNDING, SIZE
from greybox.data.files.arrays import Array
from greybox.data.files.numbers_in_text import p_text
from greybox.engine.compiled.response_part import ResponsePart
from greybox.statistics.error_growth import size_test


def unequal_errors(evidence: Evidence) -> Findings:
    """Say whether errors are larger in a part of the band than assumed.

    Of a model that explains the data: what another one misses is no error.
    """
    if not evidence.has_errors:
        return

    nlp = evidence.nlp
    values = nlp.all_values(evidence.x)
    responses = nlp.parts_of(ResponsePart)
    for part in responses:
        yield from _of_response(part, values, len(nlp.free), len(responses))


def _of_response(part: ResponsePart, values: Array, free: int, responses: int) -> Findings:
    """Judge one of the `responses`, which share the `free` parameters."""
    model, data, criterion = part.response(values), part.data, part.criterion
    size, known = criterion.error_size(model, data), criterion.known_noise
    order = np.argsort(data.omega)
    order = order[size[order] > ROUNDING * size.max()]
    # With fewer degrees of freedom, parameters that fit some points exactly leave large errors at
    # the others: of right models with 7 parameters and 8 points, 6 % were named.
    if 2 * len(order) - free / responses < 12:
        return
    squares = (np.abs(data.response - model)[order] / size[order]) ** 2
    dof = math.inf if data.dof is None or not known else data.dof[order]
    probability = size_test(squares, dof)
    thirds = [np.mean(third) for third in np.array_split(squares, 3)]
    place = ("low", "medium", "high")[np.argmax(thirds)]
    # Below this factor on the variances of half a band, intervals of 95 % contain the truth in
    # 89 % and more. Given variances that are too large do no harm, and those of a spectrum
    # include more than the scatter where leakage matters.
    is_louder = max(thirds) > 1.5 * max(np.mean(squares), known)
    # What the parameters leave of equal errors is named up to twice as often as these.
    if is_louder and probability * responses < SIZE / 2:
        yield Finding(
            f"the size of the errors of {part.name!r} changes with frequency beyond what "
            f"the criterion assumes (they are largest at {place} frequencies, "
            f"{p_text(probability)}), so that intervals may be wrong: give larger "
            f"variances at {place} frequencies to MaximumLikelihood(), or fit a part of the band."
        )
