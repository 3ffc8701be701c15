"""Whether a function of any shape is missing in the place of a likely term."""

from collections.abc import Sequence

import numpy as np

from greybox.assessment.misfit.answer import FALSE_ALARMS
from greybox.assessment.misfit.group import Candidate, Group
from greybox.assessment.misfit.ranking import Tested, tested_together
from greybox.assessment.misfit.term import RecordTerm
from greybox.data.files.arrays import Array

# Functions are tested in place of likely terms: in 1177 simulated tests 11 functions were
# significant, and where they act a term had a probability, beside white errors, below 0.015.
LIKELY = 0.02
# Samples for each knot: more knots would fit the noise of short records, which lines and initial
# states leave.
SAMPLES = 15
# Functions that are tested together with the color of the errors, which takes most of the time.
BEST = 2


def missing_functions(
    group: Group, candidates: Sequence[Candidate], tests: Sequence[Tested]
) -> tuple[list[Tested], list[float]]:
    """Return functions of any shape that are missing, and their probabilities.

    They are tested where one of the other `tests` shows anything.
    """
    places = {test.candidate.place for test in tests if test.p_white < LIKELY}
    functions = [candidate for candidate in candidates if candidate.knots]
    tried = [function for function in functions if function.place in places]
    most = max(len(group.white_residuals) // SAMPLES, 2)
    tested = []
    for function in tried:
        _, hats = function.on_knots(_signals(function), min(function.knots, most))
        tested.append(tested_together(group, hats, group.columns([hats])))

    # A test of several numbers counts as that many terms, and so do those that are not made.
    count = sum(test.effects.shape[1] for test in tested) * len(functions) / max(len(tried), 1)
    likeliest = sorted(tested, key=lambda test: test.p_white)[:BEST]
    # Only if chance does not explain them.
    best = [test for test in likeliest if max(count, 1) * test.p_white < 1]
    if not best:
        return [], []

    p_values = count * group.autoregressive_p_values([test.effects for test in best])
    missing = [k for k, p_value in enumerate(p_values) if p_value < FALSE_ALARMS]
    return [best[k] for k in missing], [float(p_values[k]) for k in missing]


def _signals(function: Candidate) -> list[Array]:
    """Return the signal of a function in every part, empty where the part lacks its place."""
    return [
        term.values if isinstance(term, RecordTerm) else np.zeros(0) for term in function.by_part
    ]
