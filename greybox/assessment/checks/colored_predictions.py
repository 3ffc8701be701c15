"""Whether prediction errors are correlated in time: another disturbance causes them."""

from collections.abc import Sequence
from dataclasses import dataclass

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
from greybox.data.files.arrays import Array
from greybox.data.files.wording import some
from greybox.modeling.colored_disturbance import ColoredDisturbance
from greybox.statistics.correlation_statistics import whiteness_of_means

# So long a filter leaves gusts of 0.15 to 2 s in the prediction errors. With 8 or 25 lags, up to a
# tenth fewer of these fits are found.
LAGS = 12
# A gust of less correlation is not worth another criterion: it biases the estimates by a fraction
# of a standard error.
LEAST_CORRELATION = 0.1


@dataclass(frozen=True)
class Color:
    """The largest correlation of means of some samples, after some of these means."""

    correlation: float
    lag: int
    samples: int

    def described(self, step: float) -> str:
        """Return the correlation in words, for samples of this step in s."""
        after = f"{self.correlation:.2g} after {self.lag * self.samples * step:.2g} s"
        return f"{after} in means of {self.samples * step:.2g} s" if self.samples > 1 else after


def _color(errors: Sequence[Array], fitted: int, level: float) -> Color | None:
    """Return how prediction errors (n,) of stretches are correlated; None where they are white."""
    tests = whiteness_of_means(errors, LAGS, fitted)
    samples, test = min(tests, key=lambda pair: pair[1].p_value)
    place = int(np.argmax(np.abs(test.correlations)))
    correlation = float(test.correlations[place])
    if test.p_value < level / len(tests) and abs(correlation) > LEAST_CORRELATION:
        return Color(correlation, place + 1, samples)
    return None


def colored_predictions(evidence: Evidence) -> Findings:
    """Warn where prediction errors are correlated in time: another disturbance causes them.

    A free gain removes the correlation from one sample to the next, so that many lags are tested;
    and noise of sensors hides slow gusts from sample to sample, so that means are tested, too.
    """
    if not evidence.is_noisy:
        return

    pairs = evidence.records
    tested, outputs = in_time(pairs, corrected=True)
    values = []
    for part, fitted in tested:
        place, step = place_of(fitted, pairs), part.data.stretches[0].step
        for output in fitted.outputs:
            errors = by_piece(fitted, fitted.residual(output))
            color = _color(errors, fitted.innovation_parameters(output), FALSE_ALARMS / outputs)
            if color:
                values.append(f"{color.described(step)} for {output}{place}")

    if values:
        part, _ = tested[0]
        has_gusts = isinstance(part.problem.model, ColoredDisturbance)
        # Gusts bias the values, until residuals look like a missing term.
        cause = (
            "as if signals were low-pass filtered, or the model is incomplete, or as in gusts: "
            f"compare with {gust_criterion(evidence, part)}"
        )
        if evidence.is_explained:
            gusts = "if gusts reached another state, too" if has_gusts else "in gusts"
            cause = (
                f"as {gusts}, which last longer than a sample: use "
                f"{gust_criterion(evidence, part)}; or as if signals were low-pass filtered"
            )
        yield Finding(
            f"the prediction errors are not white (correlation {some(values)}), {cause}. The "
            "standard errors account for their scatter, but not for the bias that a wrong model of "
            "the disturbances causes."
        )
