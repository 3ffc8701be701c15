"""Whether the noise of an output is smaller than half of its resolution."""

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.statistics.metrics import is_resolved


def rounded_outputs(evidence: Evidence) -> Findings:
    """Note outputs whose noise is smaller than half of their resolution."""
    if evidence.is_exact:
        return

    for fitted in evidence.fit.records:
        for output in fitted.outputs:
            values = fitted.data[output]
            repeats = 2 * np.unique(values).size < np.isfinite(values).sum()
            if repeats and not is_resolved(fitted.residual(output), values):
                yield Finding(
                    f"{output} in {fitted.name!r} is rounded more coarsely than its noise: "
                    "rounding errors follow the signal, so that 95 % intervals cover 88 to 95 %.",
                    f"{output} rounded",
                    fitted.name,
                    is_note=True,
                )
