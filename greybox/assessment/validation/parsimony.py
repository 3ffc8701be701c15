"""The smallest structure that the data support, in one sentence."""

from collections.abc import Sequence

from greybox.assessment.validation.comparison import SIGNIFICANT
from greybox.assessment.validation.nested_models import NestedTest
from greybox.data.files.numbers_in_text import number, p_text
from greybox.data.files.wording import listed

# Difference of BIC that is "not worth more than a bare mention" (Kass and Raftery (1995), Journal
# of the American Statistical Association 90, 773-795). BIC and not AIC: a structure is sought, not
# the best prediction.
BARE_MENTION = 2.0


def parsimony(
    labels: Sequence[str],
    bic: Sequence[float],
    sizes: Sequence[int],
    tests: Sequence[NestedTest] = (),
) -> tuple[int, str]:
    """Return the structure of fewest parameters whose BIC is within 2 of the least, and why."""
    # Among structures with equally many parameters, the one with the least BIC.
    best = min(range(len(bic)), key=lambda i: bic[i])
    near = [i for i, value in enumerate(bic) if value - bic[best] <= BARE_MENTION]
    k = min(near, key=lambda i: (sizes[i], bic[i]))
    alike = [
        labels[i]
        for i, value in enumerate(bic)
        if sizes[i] == sizes[k] and value - bic[k] <= BARE_MENTION
    ]
    text = f"{labels[k]} ({sizes[k]} free) is supported: it has the least BIC"
    if len(alike) > 1:
        text = (
            f"{listed(alike)} ({sizes[k]} free) are supported alike: their BIC differs by at most "
            f"{BARE_MENTION:g}"
        )
    elif k != best:
        text = (
            f"{labels[k]} ({sizes[k]} free) is supported: it is the smallest whose BIC is within "
            f"{BARE_MENTION:g} of the least, that of {labels[best]}"
        )
    elif len(bic) > 1:
        text += f", by {float(number(sorted(bic)[1] - bic[k], 3)):g}"
    against = [
        f"{test.large} ({p_text(test.p_value)})"
        for test in tests
        if test.small == labels[k] and test.p_value < SIGNIFICANT
    ]
    if against:
        text += f"; but a test finds more in {listed(against)}, so it is a close call"
    return k, f"{text}."
