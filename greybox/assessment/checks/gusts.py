"""Whether the residuals of a simulation are process noise, such as gusts, or noise of sensors."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.assessment.checks.records import gust_criterion
from greybox.data.files.wording import some
from greybox.engine.compiled.record_part import RecordPart
from greybox.statistics.colored_information import VERY_STRONG

# Degrees of freedom below which residuals hardly have a spectrum: with at most four, 4 to 12 % of
# 80 right models in white noise had "gusts", with six and more 1 to 4 %.
LEAST_FREEDOM = 6


def gusts(evidence: Evidence) -> Findings:
    """Name the records with gusts and the criterion for them, and test sizes that ended at zero.

    Residuals of a wrong model look like gusts, unless noise is most of them. Those of a right one
    are a remark for output error: without feedback, which has a check of its own, gusts bias
    nothing, and its standard errors follow the correlation of the residuals.
    """
    accuracy = evidence.accuracy
    rows = accuracy.nlp.rows_of(RecordPart, accuracy.trajectories, accuracy.parts)
    for part, trajectory, errors in rows:
        freedom = part.numbers - part.unknown_initial_states - len(accuracy.nlp.free)
        if part.is_static or errors.colored is None or freedom < LEAST_FREEDOM:
            continue
        steady, odds = trajectory.detail.filter, errors.colored.process_noise
        if part.gains and (steady is None or steady.gain.any()):
            continue
        if evidence.is_noisy and part.problem.model.state_names and odds() > VERY_STRONG:
            cure = "start process noise above zero"
            if not part.gains:
                cure = f"use {gust_criterion(evidence, part)}"
            like = (
                "not like noise of sensors"
                if evidence.is_explained
                else "or like what the model lacks: mend the model first, and if they still do"
            )
            yield Finding(
                f"the residuals of {part.name!r} look like gusts, {like}. In gusts, {cure}."
                f"{_of_inputs(part)}",
                is_note=evidence.is_explained and not part.gains,
            )
        elif part.gains:
            verdict = "show no process noise" if odds() < 0 else "hardly show process noise"
            yield Finding(
                f"these data {verdict}: w_{' and w_'.join(part.model.driven)} of {part.name!r} "
                "ended at zero, and OutputError has fewer unknowns."
            )


def _of_inputs(part: RecordPart) -> str:
    """Return what else looks like gusts, and that its cure is another one.

    Noise of an input moves the states as gusts do. With such noise of 5 to 20 % of the input, all
    95 % intervals of output error held the truth, while predictions that correct the states follow
    it: theirs held in 77 to 93 %.
    """
    inputs = part.system.inputs
    if part.gains or not inputs:
        return ""
    log = f"the log of {some(inputs)}"
    return f" Where {log} has noise, which looks alike, stay with OutputError()."
