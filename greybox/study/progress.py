"""How far a study is, also while it runs."""

import time

import numpy as np

from greybox.files.text_table import number
from greybox.study.study import Study


def progress(study: Study) -> str:
    """Return the counts, the time left, and the failures so far."""
    times = (float(member.answer.get("finished", 0.0)) for member in study.members)
    ends = sorted(filter(None, times))[-20:]
    unfinished = study.count("unfinished")
    lines = [study.state]
    if unfinished and len(ends) > 2:
        # The last members show how long the others take; the longest interval may be a pause.
        seconds = float(np.mean(np.sort(np.diff(ends))[:-1]))
        lines.append(
            f"about {number(unfinished * seconds / 60, 2)} min left, at {number(seconds, 2)} s a "
            f"member; the last one ended {number(time.time() - ends[-1], 2)} s ago."
        )
    return "\n\n".join(filter(None, [*lines, study.failures]))
