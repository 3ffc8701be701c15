"""Which inputs never change in any record."""

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.engine.compiled.record_part import RecordPart


def resting_inputs(evidence: Evidence) -> Findings:
    """Note inputs that never change in any record."""
    nlp = evidence.nlp
    records = nlp.parts_of(RecordPart)
    pairs = [(name, part.model.record) for part in records for name in part.system.inputs]
    moving = {name for name, record in pairs if np.ptp(record[name])}
    resting = ", ".join(sorted({name for name, _ in pairs} - moving))
    if resting and moving:
        yield Finding(
            f"the inputs never change ({resting}): their effects look like those of constants.",
            is_note=True,
        )
    # A static model has no free response.
    elif resting and len(records) == len(nlp.parts) and not any(p.is_static for p in records):
        yield Finding(
            f"the inputs never change ({resting}): only the free response is informative.",
            is_note=True,
        )
