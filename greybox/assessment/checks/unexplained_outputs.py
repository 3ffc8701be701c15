"""Which outputs the model hardly reproduces."""

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.assessment.checks.records import gust_criterion
from greybox.assessment.fitted_part import FittedRecord
from greybox.engine.compiled.record_part import RecordPart
from greybox.statistics.noise_ratio import noise_ratio


def unexplained_outputs(evidence: Evidence) -> Findings:
    """Name outputs that the model hardly reproduces."""
    for part, fitted in evidence.records:
        yield from _of_record(evidence, part, fitted)


def _of_record(evidence: Evidence, part: RecordPart, fitted: FittedRecord) -> Findings:
    """Judge the outputs of one record."""
    # With constant inputs a static model is a mean, which reproduces no variation by definition.
    is_mean = part.is_static and (part.data.constant_inputs or not part.system.inputs)
    if part.model.criterion.corrects_states or is_mean:
        return
    for k, output in enumerate(fitted.outputs):
        percent = fitted.fit_percent(output)
        if not percent < 10:
            continue
        measured = [stretch.outputs[k] for stretch in part.data.stretches]
        noise = noise_ratio(measured)
        if not fitted.data.has_time:  # the order of rows does not show the noise
            kind = "in rows"
            cure = ": try other starts or another model structure, unless that variation is noise."
        elif noise.noisy:
            kind = "noisy"
            cure = ", and the measured signal looks like noise: excite it more, or leave it out."
        elif percent < noise.attainable_fit_percent / 2:
            kind, cure = "", "try other starts, narrower start boxes, or another model structure"
            if part.problem.model.state_names:
                cure = f"in turbulence, use {gust_criterion(evidence, part)}; else {cure}"
            values = np.concatenate(measured)
            if abs(np.nanmean(values)) > np.nanstd(values):
                cure = (
                    f"if {output} is not zero at rest (trim), subtract this value, or estimate it "
                    f"by OutputError(biases=({output!r},)); {cure}"
                )
            cure = (
                ", although its noise would allow about "
                f"{noise.attainable_fit_percent:.0f} %: {cure}."
            )
        else:
            continue
        yield Finding(
            f"the model reproduces almost none of the variation of {output} in {fitted.name!r} "
            f"(fit {percent:.1f} %)" + cure,
            f"{output} {kind}",
            fitted.name,
        )
