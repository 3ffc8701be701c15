"""The verdict on a fit in a few sentences: model, minimum, parameters."""

from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Literal, NamedTuple

from greybox.assessment.identifiability import ERROR_GUIDELINE, INSENSITIVITY_GUIDELINE
from greybox.assessment.wrapped_outputs import wrapped
from greybox.data.files.named_values import without
from greybox.data.files.numbers_in_text import percent
from greybox.data.files.wording import capitalized, counted, some
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


class Opinion(NamedTuple):
    """One sentence of a verdict, and whether it is good news or a reason for doubt."""

    is_good: bool
    text: str


def verdict(fit: Any) -> Verdict:
    """Return the verdict on a `Fit`."""
    if not fit.converged:
        return Verdict("failed", (f"There is no estimate: {fit.status}.", *fit.warnings[:1]))

    # Jumps of the data explain all that follows.
    opinions = [Opinion(False, capitalized(text)) for text in wrapped(fit)]
    if fit.left_out:
        count = counted(len(fit.left_out), "check")
        text = f"{count} were left out, so nobody looked for what they find."
        opinions.append(Opinion(False, text))
    misfit = fit.misfit
    if misfit:
        # A term that the printed fit asks to add is a reason for doubt.
        is_good = misfit.explains and not misfit.is_drifting and not misfit.likely
        opinions.append(Opinion(is_good, f"The model {misfit.verdict}."))
    # Parameters can be judged only at the best minimum.
    opinions += [_opinion_of_minimum(fit), _opinion_of_parameters(fit)]

    is_good = all(opinion.is_good for opinion in opinions) and not fit.warnings
    grade = "good" if is_good else "doubt"
    # Where no response of the model explains anything, no start counts as agreeing.
    if fit.agreeing == 0 or (misfit and misfit.is_large):
        grade = "poor"

    # Reasons for doubt come first; False sorts before True.
    opinions.sort(key=attrgetter("is_good"))
    return Verdict(grade, tuple(opinion.text for opinion in opinions))


def _opinion_of_minimum(fit: Any) -> Opinion:
    """Judge how many starts agree on the best minimum."""
    # Screened starts were not run, and can neither agree nor disagree.
    count = sum(run.stage != SCREENED for run in fit.runs)
    if fit.agreeing == 1:
        few = f"1 of {count} starts reached the best minimum" if count > 1 else "one start was run"
        return Opinion(False, f"Only {few}, so another minimum may be lower: run more starts.")

    text = f"{fit.agreeing} of {counted(count, 'start')} agree on the best minimum."
    return Opinion(True, text)


def _opinion_of_parameters(fit: Any) -> Opinion:
    """Judge whether all free parameters are well determined."""
    if not fit.free:
        return Opinion(True, "No parameter was free.")
    try:
        judged = fit.identifiability
    except ValueError:
        return Opinion(
            False,
            "The data give no standard errors, so the estimate cannot be judged by itself.",
        )

    # The criterion adds biases and sizes of noise. They may be near zero, where an error relative
    # to the value says nothing.
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
        # Insensitivity is the error if all others were known: it limits no use of an estimate whose
        # error, which is larger, is within the guideline.
        is_good = not fit.at_bound and all(error <= ERROR_GUIDELINE for error in errors.values())
        return Opinion(
            is_good,
            f"Of {counted(len(fit.free), 'free parameter')}, {counted(well, 'is', 'are')} well "
            f"determined; {'; '.join(texts)}. To determine more, fix a parameter or add data.",
        )

    most = ""
    if errors:
        worst = max(errors, key=errors.__getitem__)
        most = f" of at most {percent(errors[worst])} % ({worst})"
    if fit.misfit and not fit.misfit.explains:
        # Scatter is small, but not the bias, which nobody knows.
        return Opinion(
            True,
            f"The standard errors{most} would be valid only for a model that explains the data.",
        )
    return Opinion(True, f"The free parameters are well determined, with standard errors{most}.")
