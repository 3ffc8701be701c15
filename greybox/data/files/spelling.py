"""The known name that a misspelled one resembles."""

import difflib
from collections.abc import Iterable

from greybox.data.files.escapes import sentence
from greybox.data.files.grouping import unique

MOST = 60  # names in a message


def nearest(name: str, known: Iterable[str], likeness: float = 0.6) -> str | None:
    """Return the known name most like a misspelled one; None if no known name resembles it."""
    # Capitals are the most frequent mistake.
    spelled = {candidate.lower(): candidate for candidate in known}
    matches = difflib.get_close_matches(name.lower(), spelled, n=1, cutoff=likeness)
    return spelled[matches[0]] if matches else None


def alternatives(name: object, names: Iterable[str]) -> str:
    """Return the end of a message about an unknown name: the known names, and the closest one."""
    # An output of a model may be a state, too.
    names = unique(names)
    near = nearest(str(name), names)
    listed = ", ".join(names[:MOST]) or "none"
    if len(names) > MOST:
        listed += f" and {len(names) - MOST} more"
    return sentence(listed) + (f": did you mean {near!r}?" if near else ".")
