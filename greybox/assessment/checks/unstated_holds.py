"""Whether a delay may contain half a sample, of a hold that a response does not state."""

import math

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.files.arrays import sum_of_squares
from greybox.data.files.numbers_in_text import number
from greybox.data.files.wording import some
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.intersample import HOLD, HOLD_IN_ERRORS, NO_HOLD, UNSTATED_HOLD
from greybox.engine.compiled.response_part import ResponsePart

# Deviation of the effect of a parameter from that of a delay: a Padé approximation deviates less.
LIKE_A_DELAY = 0.1
TINY = 1e-300


def unstated_holds(evidence: Evidence) -> Findings:
    """Name delays of responses that may be half a sample too long by more than a standard error.

    A hold is half a sample of delay and little else, so that the residuals do not show it. The fit
    is in doubt where the sampling interval is known; elsewhere it is a remark.
    """
    nlp, errors = evidence.nlp, evidence.fit.standard_error
    values = nlp.all_values(evidence.x)
    for part in nlp.parts_of(ResponsePart):
        if not {HOLD, NO_HOLD, HOLD_IN_ERRORS}.isdisjoint(part.data.about):
            continue
        late, is_known = _half_sample(part.data)
        shift = -1j * part.data.omega * part.response(values)
        delays = []
        for name, slope in zip(nlp.free, part.sensitivity(values).T, strict=False):
            # The delay, s, of one unit of the parameter, if it is one.
            seconds = float(np.real(np.vdot(shift, slope)) / (sum_of_squares(shift) + TINY))
            missed = np.linalg.norm(slope - seconds * shift)
            error = abs(seconds) * errors[name]
            if missed < LIKE_A_DELAY * np.linalg.norm(slope) and error < late:
                delays.append(f"{name}, {number(1e3 * error, 2)} ms,")
        if delays:
            size = f"{'' if is_known else 'up to '}{number(1e3 * late, 2)} ms"
            yield Finding(
                f"the data of {part.name!r} do not state whether the input is held between its "
                f"samples. If it is, the delay contains half a sample, {size}, which the standard "
                f"error of {some(delays)} does not include. State for how many seconds a value "
                f"lasts, 0 for an input without a hold: about={{{HOLD!r}: '0.01'}}, or the line "
                f"'# {HOLD}: 0.01' in the file.",
                "unstated hold",
                part.name,
                # Without the sampling interval nothing shows that half of it matters.
                is_note=not is_known,
            )


def _half_sample(data: FrequencyResponse) -> tuple[float, bool]:
    """Return half a sampling interval, s, and whether it is known.

    Otherwise it is the longest with which the highest frequency could be measured, two samples a
    period.
    """
    step = float(data.about.get(UNSTATED_HOLD, math.nan))
    if math.isfinite(step):
        return step / 2, True
    return math.pi / float(data.omega.max()) / 2, False
