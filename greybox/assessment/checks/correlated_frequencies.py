"""Whether the errors of a response are correlated along frequency."""

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.assessment.checks.unlikely_noise import LEAST_RATIO
from greybox.data.files.numbers_in_text import percent
from greybox.engine.compiled.response_part import ResponsePart
from greybox.statistics.neighbor_correlation import UNLIKELY


def correlated_frequencies(evidence: Evidence) -> Findings:
    """Name the responses whose errors at the estimate are correlated."""
    # The correlation of rounding, or of what a wrong model leaves, does not matter.
    if not evidence.has_errors:
        return

    nlp, accuracy = evidence.nlp, evidence.accuracy
    values = nlp.all_values(accuracy.x)
    unlikely = UNLIKELY / len(nlp.parts)
    for part, trajectory, known in nlp.rows_of(ResponsePart, accuracy.trajectories, accuracy.parts):
        is_stated = part.data.has_independent_errors
        errors = known.neighbors
        if is_stated:
            errors = part.neighbors(values, np.eye(len(nlp.free)), 1.0)
        if not errors or errors.independent >= unlikely:
            continue
        if is_stated:
            yield Finding(
                f"neighboring residuals of {part.name!r} are alike "
                f"({errors.mean:.2f} from one point to the next), although its errors are "
                "stated to be independent: the model misses something, or slow changes of the "
                "vehicle or the air lasted for several tests. Without this statement, "
                "intervals allow for it."
            )
        # Variances that include more than the scatter, such as errors of a log, need no words.
        elif (
            not part.criterion.known_noise
            or part.data.dof is None
            or part.noise_ratio(trajectory) >= LEAST_RATIO
        ):
            # For 12 points with a correlation of 0.8, intervals of 95 % contain the truth in 86 to
            # 93 % of fits, for 24 points in 91 to 98 %.
            yield Finding(
                f"the residuals of {part.name!r} are correlated along frequency "
                f"({errors.mean:.2f} from one point to the next; independent errors have a "
                "probability of "
                f"{percent(errors.independent)} %). Either the points are closer than the "
                "frequency resolution, or the model misses something; the standard errors "
                f"account for what {len(part.data)} points show of the first, but not for the "
                "second."
            )
