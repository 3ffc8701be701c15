"""The smallest structure that the data support, in one sentence."""

from collections.abc import Mapping, Sequence

from greybox.files.text_table import listed, number
from greybox.validation.comparison import SIGNIFICANT, p_text
from greybox.validation.significance import Evidence, Pair

# Difference in BIC that is "not worth more than a bare mention" (Kass and Raftery (1995), Bayes
# Factors, Journal of the American Statistical Association 90, 773-795). BIC, not AIC, as a
# structure is sought and not the best prediction.
BARE_MENTION = 2.0


def smallest_supported(bic: Sequence[float], sizes: Sequence[int]) -> int:
    """Return which structure has the fewest parameters of those whose BIC is within 2 of the least."""
    least = min(bic)
    near = [k for k, value in enumerate(bic) if value - least <= BARE_MENTION]
    return min(near, key=lambda k: (sizes[k], bic[k]))


def parsimony(
    labels: Sequence[str],
    bic: Sequence[float],
    sizes: Sequence[int],
    tests: Mapping[Pair, Evidence],
) -> tuple[int, str]:
    """Return which structure is the smallest that the data support, and why, in one sentence."""
    k = smallest_supported(bic, sizes)
    best = min(range(len(bic)), key=lambda i: bic[i])
    counts = f"{labels[k]} ({sizes[k]} free)"
    alike = [
        i for i, value in enumerate(bic) if sizes[i] == sizes[k] and value - bic[k] <= BARE_MENTION
    ]
    if len(alike) > 1:
        text = (
            f"{listed([labels[i] for i in alike])} ({sizes[k]} free) are supported alike: their BIC differs by at most "
            f"{BARE_MENTION:g}"
        )
    elif k == best:
        others = sorted(value - bic[k] for i, value in enumerate(bic) if i != k)
        text = f"{counts} is supported: it has the least BIC{f', by {number(others[0], 3)}' if others else ''}"
    else:
        text = (
            f"{counts} is supported: it is the smallest whose BIC is within {BARE_MENTION:g} of the least, that of "
            f"{labels[best]} ({number(bic[k] - bic[best], 2)} less), which is not worth more than a bare mention"
        )
    said = {
        i: evidence.nested.p_value
        for (one, i), evidence in tests.items()
        if one == k and evidence.nested is not None and evidence.nested.small == labels[k]
    }
    against = [i for i, p in said.items() if p < SIGNIFICANT]
    if against:
        tested = listed([f"{labels[i]} ({p_text(said[i])})" for i in against])
        text += f"; but tests find more in {tested}, so that it is a close call"
    elif said:
        verb = "explains" if len(said) == 1 else "explain"
        text += f", and no test finds that {listed([labels[i] for i in said])} {verb} more"
    return k, f"{text}."
