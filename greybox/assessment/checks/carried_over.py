"""Whether missing samples of an output were filled with the previous one."""

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.assessment.checks.records import FALSE_ALARMS


def carried_over(evidence: Evidence) -> Findings:
    """Name outputs that repeat values while the model moves, as where missing samples are filled.

    Where the model moves by more than the resolution, rounding leads to the next value at least as
    often as to the same one, whatever the noise.
    """
    from scipy.special import bdtrc  # noqa: PLC0415  (takes a tenth of a second to import)

    for _, fitted in evidence.records:
        for output in fitted.outputs if fitted.data.has_time else ():
            values = fitted.data[output]
            changes, moves = np.abs(np.diff([values, fitted.simulated[output]]))
            # Values that occur again after others are rounded, by steps that may differ.
            changed = values[np.append(True, changes > 0)]
            share = 0.0 if np.unique(changed).size == changed.size else 0.05
            steps = changes[changes > 0]
            step = np.quantile(steps, share, method="lower") if steps.size else np.inf
            changes = changes[moves > step]
            same = np.count_nonzero(changes == 0)
            next_values = np.count_nonzero(changes < 1.5 * step) - same
            if bdtrc(same - 1, same + next_values, 0.5) < FALSE_ALARMS:
                yield Finding(
                    f"{output} in {fitted.name!r} repeats its previous value at {same} samples "
                    "where the model moves, as if missing samples were filled. Filled samples are "
                    "late, which biases the estimates: make them NaN.",
                    f"{output} carried",
                    fitted.name,
                )
