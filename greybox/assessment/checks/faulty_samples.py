"""What a logger did to the samples of the record: repeated, interpolated, clipped, frozen ones."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.frequency_response import DAMAGE
from greybox.data.signal_faults import record_faults


def faulty_samples(evidence: Evidence) -> Findings:
    """Name the faults of the signals that were fitted."""
    for _, fitted in evidence.records:
        for fault in record_faults(fitted.data, fitted.outputs, fitted.input_names):
            text = f"in {fitted.name!r}, {fault}"
            yield Finding(text, f"{fault.kind} {fault.signal}", fitted.name)
    for fitted in evidence.fit.responses:
        if DAMAGE in fitted.data.about:
            text = f"in {fitted.name!r}, {fitted.data.about[DAMAGE]}"
            yield Finding(text, "damaged samples", fitted.name)
