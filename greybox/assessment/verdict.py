"""The verdict on a fit in a few sentences: model, minimum, parameters."""

from dataclasses import dataclass
from operator import itemgetter
from typing import Any, Literal

from greybox.assessment.identifiability import ERROR_GUIDELINE, INSENSITIVITY_GUIDELINE
from greybox.assessment.wrapped_outputs import wrapped
from greybox.data.files.named_values import without
from greybox.data.files.numbers_in_text import percent
from greybox.data.files.wording import counted, some
from greybox.engine.solve.runs import SCREENED

Grade = Literal["good", "doubt", "poor", "failed"]


LEVELS = {
    "good": "Good: use the values with their intervals.",
    "doubt": "In doubt: see the reason before you use the values.",
    "poor": "Poor: do not use the values, since the model does not describe these data.",
    "failed": "Failed: there are no values.",
}


@dataclass(frozen=True)
class Verdict:
    """A grade and sentences on a fit.

    Attributes
    ----------
    grade : "good", "doubt", "poor" or "failed"
        Poor if the model leaves more than ten times what noise would. In doubt if it leaves less
        without explaining the data, if there is a warning, if the error of a parameter is beyond
        its guideline, or if only one start reached the minimum.
    sentences : tuple of str
        Whether the model explains the data, where that can be decided; its minimum; its parameters.
        Reasons for doubt come first. For a failed fit, the reasons of the failure.
    """

    grade: Grade
    sentences: tuple[str, ...]

    @property
    def level(self) -> str:
        """What the grade means for the use of the values."""
        return LEVELS[self.grade]


def verdict(fit: Any) -> Verdict:
    """Return the verdict on a `Fit`."""
    if not fit.converged:
        return Verdict("failed", (f"There is no estimate: {fit.status}.", *fit.warnings[:1]))

    # First whether this is the minimum, then how certain: the second needs the first.
    sentences = [_minimum(fit), _determined(fit)]
    misfit = fit.misfit
    if misfit:
        # What the print says is to be added is a reason for doubt.
        holds = misfit.explains and not misfit.is_drifting and not misfit.likely
        sentences.insert(0, (holds, f"The model {misfit.verdict}."))
    if fit.left_out:
        count = counted(len(fit.left_out), "check")
        sentences.insert(0, (False, f"{count} were left out, so nobody looked for what they find."))
    # What a jump of the data does to the fit explains all that follows.
    sentences = [*((False, f"{text[0].upper()}{text[1:]}") for text in wrapped(fit)), *sentences]
    is_good = all(is_good for is_good, _ in sentences) and not fit.warnings
    grade = "good" if is_good else "doubt"
    # No start agrees on the minimum of a model that explains nothing, wherever they end.
    if fit.agreeing == 0 or (misfit and misfit.is_large):
        grade = "poor"

    return Verdict(grade, tuple(text for _, text in sorted(sentences, key=itemgetter(0))))


def _minimum(fit: Any) -> tuple[bool, str]:
    """Tell whether more than one start agrees on the best minimum, and say how many do."""
    # Screened starts were not run, and can neither agree nor disagree.
    count = sum(run.stage != SCREENED for run in fit.runs)
    if fit.agreeing == 1:
        few = f"1 of {count} starts reached the best minimum" if count > 1 else "one start was run"
        return False, f"Only {few}, so another minimum may be lower: run more starts."

    return True, f"{fit.agreeing} of {counted(count, 'start')} agree on the best minimum."


def _determined(fit: Any) -> tuple[bool, str]:
    """Tell whether all free parameters are well determined, and say how well."""
    if not fit.free:
        return True, "No parameter was free."
    try:
        judged = fit.identifiability
    except ValueError:
        return (
            False,
            "The data give no standard errors, so the estimate cannot be judged by itself.",
        )

    # Biases and sizes of noise, which the criterion adds, are no less known for being near zero.
    added = {part.outside(name) for part in fit.parts for name in part.added}
    errors = without(dict(zip(judged.names, judged.error, strict=True)), added)
    beyond = [name for name in judged.beyond if name in errors]
    texts = []
    if fit.at_bound:
        texts.append(f"{some(fit.at_bound)} ended at a bound")
    if beyond:
        texts.append(
            f"{some(beyond)} exceeded the guidelines ({100 * ERROR_GUIDELINE:.0f} % error, "
            f"{100 * INSENSITIVITY_GUIDELINE:.0f} % insensitivity)"
        )

    if texts:
        well = len(fit.free) - len({*fit.at_bound, *beyond})
        return (
            # Insensitivity is the error if all others were known: it limits no use of an estimate
            # whose error, which is larger, is within the guideline.
            not fit.at_bound and all(error <= ERROR_GUIDELINE for error in errors.values()),
            f"Of {counted(len(fit.free), 'free parameter')}, {counted(well, 'is', 'are')} well "
            f"determined; {'; '.join(texts)}. To determine more, fix a parameter or add data.",
        )

    worst = max(errors, key=errors.__getitem__, default="")
    most = f" of at most {percent(errors[worst])} % ({worst})" if worst else ""
    if fit.misfit and not fit.misfit.explains:
        # Scatter is small, but not the bias, which nobody knows.
        return (
            True,
            f"The standard errors{most} would be valid only for a model that explains the data.",
        )
    return True, f"The free parameters are well determined, with standard errors{most}."
