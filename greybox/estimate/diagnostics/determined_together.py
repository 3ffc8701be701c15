"""Which combinations the data determine although their members are not."""

from collections.abc import Iterator

from greybox.estimate.result import Fit
from greybox.files.text_table import listed

MOST = 3  # combinations that the answer shows; `Fit.identifiability` has them all


def determined_together(fit: Fit) -> Iterator[str]:
    """Say which combinations are determined although none of their members is."""
    found = fit.identifiability.combinations if fit.converged and fit.directions is not None else ()
    if not found:
        return
    members = tuple(dict.fromkeys(name for combination in found for name in combination.names))
    more = f" and {len(found) - MOST} more" if len(found) > MOST else ""
    yield (
        f"{'; '.join(str(combination) for combination in found[:MOST])}{more}: determined together, although "
        f"{listed(members)} are not; print(fit.identifiability) shows how well each is."
    )
