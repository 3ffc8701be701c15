"""Warnings about records: samples that were not compared, uninformative signals, residuals that are not white."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.kalman_gain import kalman_gain
from greybox.compiled.part import Trajectory
from greybox.compiled.record_information import FEWEST_TIMES
from greybox.compiled.record_part import RecordPart
from greybox.data.record import Record
from greybox.estimate.covariance import Accuracy
from greybox.estimate.diagnostics.repeated import Found, once
from greybox.estimate.fitted_part import FittedPart, FittedRecord
from greybox.files.arrays import Array
from greybox.files.text_table import counted, some
from greybox.statistics.metrics import feedback_correlation, whiteness
from greybox.statistics.noise_ratio import noise_ratio

MASKED = 0.05  # share of the samples of a record from which their loss is told
LITTLE = 10.0  # fit in percent below which a model reproduces almost nothing
SHARE = 0.5  # of the fit that noise allows, from which a model reproduces what it can
FACTOR = 5.0  # between standard deviations of one output in several records
GREY = 0.2  # correlation of successive prediction errors that is told
BIASED = 0.01  # share of fits without a bias by feedback in which one is told
# Times by which an interval of 95 % may be too narrow before that is told: it then holds in 81 % of
# records.
NARROW = 1.5
CERTAIN = (
    5.0  # standard deviations of the correlation of white residuals, beyond which there is one
)
HUGE = 1e6  # what is beyond is rounding: there is no noise


def finding_warnings(nlp: CompiledProblem) -> tuple[str, ...]:
    """Return what was found when the records were read: restarts of the clock, lost lines, text instead of numbers."""
    pairs = [(part.name, part.data) for part in nlp.problem.parts if isinstance(part.data, Record)]
    # Findings of one kind differ in their numbers.
    return tuple(
        once(
            (re.sub(r"[\d.]+", "", text), record.name or name, f"data of {name!r}: {text}")
            for name, record in pairs
            for text in record.findings
        )
    )


def record_warnings(
    nlp: CompiledProblem,
    fitted: Sequence[FittedPart],
    trajectories: Sequence[Trajectory],
    accuracy: Accuracy,
) -> tuple[str, ...]:
    """Return what a reader should know of the records among the parts of an answer."""
    every = zip(nlp.parts, fitted, strict=True)
    pairs = [
        (part, one)
        for part, one in every
        if isinstance(part, RecordPart) and isinstance(one, FittedRecord)
    ]
    return (
        *once(_short(nlp, accuracy)),
        *once(
            found
            for part, fitted in pairs
            for found in _unexplained(part, fitted, alone=len(pairs) == 1)
        ),
        *_fed_back(pairs),
        *_colored(pairs),
        *once(_bounded(nlp, trajectories, alone=len(pairs) == 1)),
        *once(found for part, _ in pairs for found in _masked(nlp, part)),
        *(_resting([part for part, _ in pairs]) if len(pairs) == len(nlp.parts) else ()),
        *_weights(
            [_Residuals.of(part, fitted) for part, fitted in pairs if part.covariance.known is None]
        ),
    )


def hidden_errors(accuracy: Accuracy) -> Iterator[str]:
    """Say that slow errors which the residuals do not exclude would make the intervals much wider.

    Those of several records are independent numbers. No warning, since most short records hold no
    such errors. Where errors are known to be slow, `record_warnings` says so.
    """
    found = [known for known in accuracy.correlation if known is not None]
    if math.hypot(*(math.log(known.hidden) / 2 for known in found)) <= math.log(NARROW):
        return  # Student's quantile, whose import takes a tenth of a second, would only narrow them
    wider = math.exp(math.hypot(*(math.log(known.wider) for known in found)))
    if wider > NARROW and all(known.is_long_enough for known in found):
        yield (
            "so short a record hides slow errors, such as drift or gusts, in its noise: those that the residuals do "
            f"not exclude would make the intervals up to {wider:.2g} times wider than they are."
        )


def _short(nlp: CompiledProblem, accuracy: Accuracy) -> Iterator[Found]:
    """Name records that are too short for the correlation of their errors to be known."""
    for part, found in zip(nlp.parts, accuracy.correlation, strict=False):
        if not isinstance(part, RecordPart) or found is None or found.is_long_enough:
            continue
        slowest = int(np.argmax(found.correlation_times))
        time = float(found.correlation_times[slowest])
        name = part.model.record.name or part.problem.name
        where = "" if len(nlp.parts) == 1 else f" in {name!r}"
        text = (
            f"the residuals of {part.outputs[slowest]}{where} stay correlated for about {time:.2g} s, and the longest "
            f"gap-free stretch lasts only {found.duration / time:.2g} times that, less than {FEWEST_TIMES:g}: "
            "it is too short to show the size of slow errors, so the standard errors are rough "
            f"({counted(max(round(found.dof), 1), 'degree of', 'degrees of')} freedom); use a longer record."
        )
        yield part.outputs[slowest], name, text


def _unexplained(part: RecordPart, fitted: FittedRecord, *, alone: bool) -> Iterator[Found]:
    if part.model.criterion.corrects_states:
        return
    if part.is_static and (
        part.data.constant_inputs or not part.system.inputs
    ):  # a mean, which explains nothing
        return
    for k, output in enumerate(fitted.outputs):
        percent = fitted.fit_percent(output)
        if not percent < LITTLE:
            continue
        record = fitted.data.name or fitted.name
        name = output if alone else f"{output} in {record!r}"
        if not fitted.data.has_time:  # nothing varies from row to row that would show the noise
            text = (
                f"the model reproduces almost none of the variation of {name} (fit {percent:.1f} %): try other starts, "
                "or another model structure, unless that variation is noise."
            )
            yield f"{output} in rows", record, text
            continue
        found = noise_ratio([stretch.outputs[k] for stretch in part.data.stretches])
        if found.noisy:
            text = (
                f"{name} is indistinguishable from noise, and the model reproduces almost none of its variation (fit "
                f"{percent:.1f} %): it carries little information on the parameters; excite it more, or leave it out."
            )
            yield f"{output} noisy", record, text
        elif percent < SHARE * found.attainable_fit_percent:
            text = (
                f"the model reproduces almost none of the variation of {name} (fit {percent:.1f} %), where its noise "
                f"from sample to sample would allow about {found.attainable_fit_percent:.0f} %: try other starts, "
                "narrower start boxes, or another model structure."
            )
            yield output, record, text


def _colored(pairs: Sequence[tuple[RecordPart, FittedRecord]]) -> Iterator[str]:
    """Say where prediction errors are correlated in time, which their standard errors do not account for."""
    predicted = []
    for part, fitted in pairs:
        if not part.model.criterion.errors_are_white:
            continue
        for output in fitted.outputs:
            value, count = _successive(fitted.residual(output))
            if abs(value) > max(GREY, CERTAIN / math.sqrt(max(count, 1))):
                where = "" if len(pairs) == 1 else f" in {fitted.data.name or fitted.name!r}"
                predicted.append(f"{value:.3g} for {output}{where}")
    if predicted:
        yield (
            f"the prediction errors are not white ({some(predicted)} from one sample to the next): the signals "
            "were low-pass filtered, a state that the noise reaches is not corrected, or the model is incomplete; the "
            "standard errors, which assume white prediction errors, are then wrong."
        )


def _fed_back(pairs: Sequence[tuple[RecordPart, FittedRecord]]) -> Iterator[str]:
    """Say where feedback responds to errors that are correlated in time: output error is then biased.

    Output error needs errors that are independent of past inputs. Feedback makes later inputs
    depend on the errors, which does no harm as long as they are white: then no error depends on an
    earlier one, nor on the inputs that responded to it. So two tests must reject: residuals against
    past outputs (are they white?), and inputs against past residuals (is there feedback?). Each is
    made at the level that keeps the share of fits with a false alarm below `BIASED`, however many
    outputs and inputs there are, since without a bias one of the two hypotheses holds.
    """
    tested = [
        (part, fitted)
        for part, fitted in pairs
        if fitted.data.has_time and not part.model.criterion.errors_are_white
    ]
    outputs = sum(len(fitted.outputs) for _, fitted in tested)
    found = []
    for part, fitted in tested:
        ends = np.cumsum([len(piece) for piece in fitted.data.pieces])[:-1]
        inputs = {name: np.split(fitted.data[name], ends) for name in part.system.inputs}
        where = "" if len(pairs) == 1 else f" in {fitted.data.name or fitted.name!r}"
        for output in fitted.outputs:
            residuals = np.split(fitted.residual(output), ends)
            if not whiteness(residuals).p_value < BIASED / outputs:
                continue
            responses = {
                name: feedback_correlation(residuals, u).p_value for name, u in inputs.items()
            }
            found += [
                f"{name} to {output}{where}"
                for name, p_value in responses.items()
                if p_value < BIASED / (outputs * len(inputs))
            ]
    if found:
        static = all(part.is_static for part, _ in tested)
        yield (
            f"feedback responds to errors that are correlated in time ({some(found)}), as where a controller acts "
            "on process noise such as gusts: the estimate of OutputError is then biased, which its standard errors do "
            f"not show (a false alarm in at most {100 * BIASED:g} % of fits); "
            + (
                "use data without feedback."
                if static
                else "compare with criterion=PredictionError()."
            )
        )


def _bounded(
    nlp: CompiledProblem, trajectories: Sequence[Trajectory], *, alone: bool
) -> Iterator[Found]:
    """Say where a Kalman gain has reached the stability limit."""
    for part, trajectory in zip(nlp.parts, trajectories, strict=True):
        gain = kalman_gain(part)
        if gain is not None and gain.is_at_limit(trajectory):
            name = gain.part.model.record.name or part.problem.name
            where = "" if alone else f" of {name!r}"
            text = (
                f"the Kalman gain{where} reached the stability limit: the data show no process noise in a state that "
                "it corrects, and the standard errors, which do not account for the limit, are too small; name fewer "
                "states in PredictionError(corrected=...), or compare with OutputError()."
            )
            yield "limit", name, text


def _successive(error: Array) -> tuple[float, int]:
    """Return the correlation of successive residuals, and of how many pairs."""
    both, squares = np.isfinite(error[1:]) & np.isfinite(error[:-1]), float(np.nansum(error**2))
    return float(error[1:][both] @ error[:-1][both]) / squares if squares else 0.0, int(both.sum())


def _masked(nlp: CompiledProblem, part: RecordPart) -> Iterator[Found]:
    """Name samples that were not compared since a delay that is estimated may reach before the record."""
    lost, data, system = part.data.masked, part.model.record, part.system
    there = int(np.any([np.isfinite(data[name]) for name in part.outputs], axis=0).sum())
    p = ca.SX.sym("p", len(system.parameters))
    delay = system.delay(p)
    locals_ = [name for j, name in enumerate(system.parameters) if ca.depends_on(delay, p[j])]
    names = [part.problem.rename.get(name, name) for name in locals_]
    if lost <= MASKED * there or not any(
        name in nlp.free or name not in nlp.names for name in names
    ):
        return
    known = part.problem.parameters
    bounds = [
        f"{name} (up to {known[name].bounds[1]:g} {known[name].unit})"
        for name in names
        if name in known
    ]
    name = data.name or part.problem.name
    text = (
        f"{lost} of {counted(there, 'sample')} of {name!r} were not compared: the inputs "
        "move at the beginning, and what they did before, for the largest delay the bounds allow, is not known; lower "
        f"the upper bound of {' and '.join(bounds) or ' and '.join(names)}, or begin the record where the inputs rest."
    )
    yield "masked", name, text


def _resting(parts: Sequence[RecordPart]) -> Iterator[str]:
    """Say that nothing was excited, where that holds for all data; a static model has no free response."""
    if any(part.is_static for part in parts) or not all(
        part.data.constant_inputs for part in parts
    ):
        return
    inputs = dict.fromkeys(name for part in parts for name in part.system.inputs)
    which = "the record" if len(parts) == 1 else "any record"
    yield (
        f"the inputs never change in {which} ({', '.join(inputs)}): only the free response is informative."
    )


@dataclass(frozen=True)
class _Residuals:
    """Standard deviations by output of the residuals of one record, and how many there are."""

    name: str
    deviation: dict[str, float]
    count: dict[str, int]

    @classmethod
    def of(cls, part: RecordPart, fitted: FittedRecord) -> "_Residuals":
        deviation = np.sqrt(np.diag(fitted.noise)).tolist()
        names = fitted.outputs
        return cls(
            fitted.data.name or fitted.name,
            dict(zip(names, deviation, strict=True)),
            dict(zip(names, part.covariance.counts.tolist(), strict=True)),
        )


def _weights(found: Sequence[_Residuals]) -> Iterator[str]:
    """Say where records weigh very differently because each has its own estimated variance of the same output."""
    for output in dict.fromkeys(name for one in found for name in one.deviation):
        there = sorted(
            (one for one in found if one.count.get(output)), key=lambda one: one.deviation[output]
        )
        if len(there) < 2:
            continue
        least, most = there[0], there[-1]
        ratio = most.deviation[output] / max(least.deviation[output], 1e-300)
        if not FACTOR < ratio < HUGE:
            continue
        yield (
            f"the fitted standard deviation of {output} is {most.deviation[output]:.2g} in {most.name!r} and "
            f"{least.deviation[output]:.2g} in {least.name!r}, so that a sample of the latter weighs "
            f"{float(f'{ratio**2:.2g}'):g} times as much: where the sensor is the same, give all records the same one, "
            f"noise={_pooled(there)}."
        )


def _pooled(found: Sequence[_Residuals]) -> str:
    """Write the option of the criterion that gives every record the standard deviation of all."""
    texts = []
    for output in found[0].deviation:
        there = [one for one in found if one.count.get(output)]
        squares = sum(one.count[output] * one.deviation[output] ** 2 for one in there)
        count = sum(one.count[output] for one in there)
        texts.append(f"{output!r}: {math.sqrt(squares / count):.2g}" if count else f"{output!r}: 1")
    return f"{{{', '.join(texts)}}}"
