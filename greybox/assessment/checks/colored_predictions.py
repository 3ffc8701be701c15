"""Whether prediction errors are correlated in time: another disturbance causes them."""

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.assessment.checks.records import (
    FALSE_ALARMS,
    by_piece,
    gust_criterion,
    in_time,
    place_of,
)
from greybox.data.files.wording import some
from greybox.modeling.colored_disturbance import ColoredDisturbance
from greybox.statistics.correlation_statistics import whiteness


def colored_predictions(evidence: Evidence) -> Findings:
    """Warn where prediction errors are correlated in time: another disturbance causes them.

    A free gain removes the correlation from one sample to the next, so that many lags are tested.
    """
    if not evidence.is_noisy:
        return

    pairs = evidence.records
    tested, outputs = in_time(pairs, corrected=True)
    values = []
    for part, fitted in tested:
        for output in fitted.outputs:
            errors = by_piece(fitted, fitted.residual(output))
            # So long a filter leaves gusts of 0.15 to 2 s in the prediction errors. With 8 or 25
            # lags, up to a tenth fewer of these fits are found.
            test = whiteness(errors, 12, fitted.innovation_parameters(output))
            lag = np.argmax(np.abs(test.correlations))
            r = test.correlations[lag]
            # A gust of less correlation is not worth another criterion: it biases the estimates by
            # a fraction of a standard error.
            if test.p_value < FALSE_ALARMS / outputs and abs(r) > 0.1:
                place = place_of(fitted, pairs)
                delay = part.data.stretches[0].step * (lag + 1)
                values.append(f"{r:.2g} after {delay:.2g} s for {output}{place}")

    if values:
        part, _ = tested[0]
        has_gusts = isinstance(part.problem.model, ColoredDisturbance)
        cause = (
            f"as in gusts, which last longer than a sample: use {gust_criterion(part)}; or as if "
            "signals were low-pass filtered"
            if evidence.is_explained and not has_gusts
            else "as if signals were low-pass filtered, gusts reached another state, or the model "
            "is incomplete"
        )
        yield Finding(
            f"the prediction errors are not white (correlation {some(values)}), {cause}. The "
            "standard errors account for their scatter, but not for the bias that a wrong model of "
            "the disturbances causes."
        )
