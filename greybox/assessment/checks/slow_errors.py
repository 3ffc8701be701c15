"""Whether errors stay correlated where few frequencies show the parameters."""

import math

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.engine.compiled.record_part import RecordPart

# 2 log of the evidence for slow errors above which these are likely: in 160 right fits of 60 to
# 600 samples it was at most 4.
EVIDENCE = 4.0


# Fourier frequencies with the information on the parameters, at least. Errors at fewer follow from
# their spectrum at others: with 1/f noise, intervals of 95 % held in 90 % of such fits.
FEWEST_LINES = 8.0


def slow_errors(evidence: Evidence) -> Findings:
    """Name the outputs whose errors are slow, if few frequencies show the parameters."""
    if not (evidence.is_noisy and evidence.is_explained):
        return

    outputs = sum(len(fitted.outputs) for fitted in evidence.fit.records)
    for part, errors in evidence.nlp.rows_of(RecordPart, evidence.accuracy.parts):
        if not (colored := errors.colored):
            continue
        for output, odds, lines in zip(part.outputs, *colored.slow_errors(), strict=False):
            if odds > EVIDENCE + 2 * math.log(outputs) and 0 < lines < FEWEST_LINES:
                yield Finding(
                    f"the residuals of {output} in {part.name!r} stay correlated, and only about "
                    f"{lines:.1g} frequencies of the record show the parameters, where slow errors "
                    "look like the response. The standard errors are rough: use an input of more "
                    "frequencies, or a longer record.",
                    output,
                    part.name,
                )
