"""Whether the residuals in time look like noise, and whether all samples were compared."""

import math
import re
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.kalman_gain import kalman_gain
from greybox.compiled.record_part import RecordPart
from greybox.compiled.response_part import ResponsePart
from greybox.data.record import Record, share_samples
from greybox.data.units import known_unit, misspelled
from greybox.estimate.covariance import Accuracy
from greybox.estimate.diagnostics.repeated import Findings, once
from greybox.estimate.fitted_part import FittedRecord
from greybox.estimate.missing_terms import dynamic_equations
from greybox.estimate.result import Fit
from greybox.files.arrays import Array, Strings
from greybox.files.grouping import grouped
from greybox.files.text_table import Sentences, listed, some
from greybox.modeling.colored_disturbance import ColoredDisturbance
from greybox.modeling.model import Model
from greybox.statistics.metrics import cross_correlation, is_resolved, whiteness
from greybox.statistics.noise_ratio import noise_ratio

Pairs = Sequence[tuple[RecordPart, FittedRecord]]

# Share of fits with a false alarm about feedback, and about colored prediction errors.
FALSE_ALARMS = 0.01

# 2 log of the evidence for slow errors above which these are likely: in 160 right fits of 60 to
# 600 samples it was at most 4.
EVIDENCE = 4.0

# Fourier frequencies with the information on the parameters, at least. Errors at fewer follow from
# their spectrum at others: with 1/f noise, intervals of 95 % held in 90 % of such fits.
FEWEST_LINES = 8.0


def finding_warnings(nlp: CompiledProblem) -> Sentences:
    """Repeat the findings of the log reader: restarts of the clock, lost lines."""
    return once(
        # Findings of one kind differ in their numbers.
        (re.sub(r"[\d.]+", "", text), part.name, f"data of {part.name!r}: {text}")
        for part in nlp.problem.parts_with(Record)
        for text in (*part.data.findings, *_misspelled_units(part.model, part.data))
        # What a unit was taken for is certain where the model declares it.
        if text.partition(":")[0] not in part.model.units
    )


def _misspelled_units(model: Model, data: Record) -> Sentences:
    for name in (*model.input_names, *model.output_names):
        unit = data.units.get(name, "")
        if known_unit(unit) is None and (text := misspelled(unit)):
            yield f"{name}: {text}."


def repeated_data(nlp: CompiledProblem) -> Sentences:
    """Name data that are fitted twice, such as a file that was given twice."""
    pairs = [
        (group[0].name, again.name, "points")
        for group in grouped(nlp.parts_of(ResponsePart), lambda part: part.data.checksum)
        for again in group[1:]
    ]
    for first, again in combinations(nlp.parts_of(RecordPart), 2):
        earlier, later = first.model.record, again.model.record
        outputs = {*first.outputs} & {*again.outputs}
        if outputs and earlier.checksum == later.checksum and share_samples(earlier, later):
            pairs.append((first.name, again.name, f"samples of {listed(sorted(outputs))}"))

    return once(
        (
            "repeated",
            name,
            f"{first!r} and {name!r} have the same {numbers}, which count twice: the standard "
            "errors are too small; leave one of them out.",
        )
        for first, name, numbers in pairs
    )


def record_warnings(answer: Fit, accuracy: Accuracy, *, noisy: bool) -> Strings:
    """Return the warnings about the records of a fit.

    Residuals of a wrong model look like feedback, which is then not tested, and like gusts unless
    the model explains the data.
    """
    misfit, explained = answer.misfit, answer.is_explained
    pairs = accuracy.nlp.rows_of(RecordPart, answer.parts)
    unstable = bool(misfit and misfit.is_unstable)
    # Noise that feedback returns to an unstable model biases output error: with 10 to 14 % of the
    # variance by 0.6 to 1.5 standard errors, with 1 to 4 % by less than the intervals leave.
    answered = bool(misfit and unstable and (misfit.left > 0.1 or not explained))

    return (
        *(once(_slow(answer, accuracy)) if noisy and explained else ()),
        *once(finding for pair in pairs for finding in unexplained_outputs(*pair)),
        *(biased_by_feedback(pairs, unstable=unstable, answered=answered) if noisy else ()),
        *(colored_predictions(pairs, explained=explained) if noisy else ()),
        *once(_bounded(accuracy)),
        *once(_flattened_inputs(pairs)),
        *once(_carried_over(pairs)),
    )


def _flattened_inputs(pairs: Pairs) -> Findings:
    """Name inputs of a limited band that lines between samples attenuate."""
    for part, _ in pairs:
        stretch = max(part.data.stretches, key=len)
        is_uniform = part.model.has_time and stretch.times is None
        if not is_uniform or part.model.criterion.inputs == "linear":
            continue
        for name, between, values in zip(
            part.system.inputs, part.model.between, stretch.inputs, strict=True
        ):
            power = np.abs(np.fft.rfft(np.hanning(values.size) * (values - values.mean()))) ** 2
            rate = np.fft.rfftfreq(values.size)
            # Steps and corners have power at all frequencies: they are lines, or held.
            if between.held or power[rate > 0.3].sum() >= 1e-3 * power.sum():
                continue
            # Lines through samples are these samples, each a triangle: its spectrum is sinc².
            lost = power @ (1 - np.sinc(rate) ** 4) / power.sum()
            # A multisine up to 0.2 of the sampling rate loses 9 %, a sweep up to a tenth of it 2 %.
            if lost > 0.04:
                yield (
                    f"{name} flattened",
                    part.name,
                    f"{name} moves fast for its sampling rate: lines between its samples lose "
                    f"{100 * lost:.1f} % of its power, which shifts the estimates. Give it at a "
                    "higher rate (interpolated by its band, as by scipy.signal.resample), with "
                    "outputs NaN in between, or state its hold; inputs='linear' states that it "
                    "varies in straight lines.",
                )


def _carried_over(pairs: Pairs) -> Findings:
    """Name outputs that repeat values while the model moves, as where missing samples are filled.

    Where the model moves by more than the resolution, rounding leads to the next value at least as
    often as to the same one, whatever the noise.
    """
    from scipy.special import bdtrc  # noqa: PLC0415  (takes a tenth of a second to import)

    for _, fitted in pairs:
        for output in fitted.outputs if fitted.data.has_time else ():
            values = fitted.data[output]
            changes, moves = np.abs(np.diff([values, fitted.simulated[output]]))
            # Values that occur again after others are rounded, by steps that may differ.
            changed = values[np.append(True, changes > 0)]
            share = 0.0 if np.unique(changed).size == changed.size else 0.05
            steps = changes[changes > 0]
            step = np.quantile(steps, share, method="lower") if steps.size else np.inf
            changes = changes[moves > step]
            same = np.count_nonzero(changes == 0)
            next_values = np.count_nonzero(changes < 1.5 * step) - same
            if bdtrc(same - 1, same + next_values, 0.5) < FALSE_ALARMS:
                yield (
                    f"{output} carried",
                    fitted.name,
                    f"{output} in {fitted.name!r} repeats its previous value at {same} samples "
                    "where the model moves, as if missing samples were filled. Filled samples are "
                    "late, which biases the estimates: make them NaN.",
                )


def _slow(answer: Fit, accuracy: Accuracy) -> Findings:
    """Name the outputs whose errors are slow, if few frequencies show the parameters."""
    outputs = sum(len(fitted.outputs) for fitted in answer.records)
    for part, errors in accuracy.nlp.rows_of(RecordPart, accuracy.parts):
        if not (colored := errors.colored):
            continue
        for output, evidence, lines in zip(part.outputs, *colored.slow_errors(), strict=False):
            if evidence > EVIDENCE + 2 * math.log(outputs) and 0 < lines < FEWEST_LINES:
                yield (
                    output,
                    part.name,
                    f"the residuals of {output} in {part.name!r} stay correlated, and only about "
                    f"{lines:.1g} frequencies of the record show the parameters, where slow errors "
                    "look like the response. The standard errors are rough: use an input of more "
                    "frequencies, or a longer record.",
                )


def unexplained_outputs(part: RecordPart, fitted: FittedRecord) -> Findings:
    """Name outputs that the model hardly reproduces."""
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
                cure = f"in turbulence, use {gust_criterion(part)}; else {cure}"
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
        yield (
            f"{output} {kind}",
            fitted.name,
            f"the model reproduces almost none of the variation of {output} in {fitted.name!r} "
            f"(fit {percent:.1f} %)" + cure,
        )


def colored_predictions(pairs: Pairs, *, explained: bool = True) -> Sentences:
    """Warn where prediction errors are correlated in time: another disturbance causes them.

    A free gain removes the correlation from one sample to the next, so that many lags are tested.
    """
    tested, outputs = _in_time(pairs, corrected=True)
    values = []
    for part, fitted in tested:
        for output in fitted.outputs:
            errors = _by_piece(fitted, fitted.residual(output))
            # So long a filter leaves gusts of 0.15 to 2 s in the prediction errors. With 8 or 25
            # lags, up to a tenth fewer of these fits are found.
            test = whiteness(errors, 12, fitted.innovation_parameters(output))
            lag = np.argmax(np.abs(test.correlations))
            r = test.correlations[lag]
            # A gust of less correlation is not worth another criterion: it biases the estimates by
            # a fraction of a standard error.
            if test.p_value < FALSE_ALARMS / outputs and abs(r) > 0.1:
                place = _place(fitted, pairs)
                delay = part.data.stretches[0].step * (lag + 1)
                values.append(f"{r:.2g} after {delay:.2g} s for {output}{place}")

    if values:
        part, _ = tested[0]
        has_gusts = isinstance(part.problem.model, ColoredDisturbance)
        cause = (
            f"as in gusts, which last longer than a sample: use {gust_criterion(part)}; or as if "
            "signals were low-pass filtered"
            if explained and not has_gusts
            else "as if signals were low-pass filtered, gusts reached another state, or the model "
            "is incomplete"
        )
        yield (
            f"the prediction errors are not white (correlation {some(values)}), {cause}. The "
            "standard errors account for their scatter, but not for the bias that a wrong model of "
            "the disturbances causes."
        )


def gust_criterion(part: RecordPart) -> str:
    """Return the code of the criterion that estimates gusts, for a state that they may reach."""
    place = next(iter(dynamic_equations(part)))
    return f"PredictionError(disturbance={{{part.system.states[place]!r}: 'colored'}})"


def _in_time(pairs: Pairs, *, corrected: bool) -> tuple[Pairs, int]:
    """Return the pairs in time whose states are corrected, or not, and their number of outputs."""
    chosen = [
        (part, fitted)
        for part, fitted in pairs
        if fitted.data.has_time and part.model.criterion.corrects_states == corrected
    ]
    return chosen, sum(len(fitted.outputs) for _, fitted in chosen)


def _by_piece(fitted: FittedRecord, values: Array) -> list[Array]:
    """Return values (n,) split at gaps: lags across one would compare samples far apart."""
    return [values[rows] for rows in fitted.data.independent_pieces]


def biased_by_feedback(
    pairs: Pairs, *, unstable: bool = False, answered: bool = False
) -> Sentences:
    """Warn where feedback responds to errors correlated in time: output error is then biased.

    Output error needs errors that are independent of past inputs. Feedback makes later inputs
    depend on the errors, which does no harm as long as they are white: then no error depends on an
    earlier one, nor on the inputs that responded to it. So two tests must reject: residuals against
    past outputs (are they white?), and inputs against past residuals (is there feedback?). The
    level of each keeps the share of fits with a false alarm below `FALSE_ALARMS` for any number of
    outputs and inputs, since without a bias one of the two hypotheses is true. The states of an
    `unstable` model stay within the record only by feedback, which then needs no test: past errors
    reach the inputs through many samples, and the second test misses them. They follow
    from later inputs, too, in which white errors are `answered` where these are large, or where the
    model does not explain the data: that may be all that is wrong.
    """
    tested, outputs = _in_time(pairs, corrected=False)
    responding = []

    for part, fitted in tested:
        inputs = {name: _by_piece(fitted, fitted.data[name]) for name in part.system.inputs}
        place = _place(fitted, pairs)
        for output in fitted.outputs:
            e = fitted.residual(output)
            residuals = _by_piece(fitted, e)
            is_white = not whiteness(residuals).p_value < FALSE_ALARMS / outputs
            # Rounding follows the inputs in advance, if these repeat.
            if (is_white and not answered) or not is_resolved(e, fitted.data[output]):
                continue
            responding += [
                f"{name} to {output}{place}"
                for name, u in inputs.items()
                if unstable
                or cross_correlation(u, residuals).p_value < FALSE_ALARMS / outputs / len(inputs)
            ]

    if responding:
        places = some(responding)
        yield (
            (
                f"feedback answers the errors of an unstable model, noise or gusts ({places}), "
                "which may also look like a missing term. The estimate of OutputError is then "
                "biased, which its standard errors do not show; "
                if answered
                else f"feedback responds to errors that are correlated in time ({places}), as "
                "where a controller acts on process noise such as gusts. The estimate of "
                "OutputError is then biased, which its standard errors do not show (a false alarm "
                f"in at most {100 * FALSE_ALARMS:g} % of fits); "
            )
            + (
                "use data without feedback."
                if all(part.is_static for part, _ in tested)
                else "compare with criterion=PredictionError()."
            )
        )


def _bounded(accuracy: Accuracy) -> Findings:
    """Warn where a Kalman gain has reached the stability limit."""
    for part, trajectory in zip(accuracy.nlp.parts, accuracy.trajectories, strict=True):
        gain = kalman_gain(part)
        if gain and gain.is_at_limit(trajectory):
            yield (
                "limit",
                part.name,
                f"the Kalman gain in {part.name!r} reached the stability limit, as if the data "
                "showed no process noise in a state that it corrects. The standard errors do not "
                "account for the limit and are too small: let it correct fewer states, or compare "
                "with OutputError().",
            )


def _place(fitted: FittedRecord, pairs: Pairs) -> str:
    """Return which record is meant; nothing where there is only one."""
    return "" if len(pairs) == 1 else f" in {fitted.name!r}"


def resting_inputs(nlp: CompiledProblem) -> Sentences:
    """Note inputs that never change in any record."""
    records = nlp.parts_of(RecordPart)
    pairs = [(name, part.model.record) for part in records for name in part.system.inputs]
    moving = {name for name, record in pairs if np.ptp(record[name])}
    resting = ", ".join(sorted({name for name, _ in pairs} - moving))
    if resting and moving:
        yield f"the inputs never change ({resting}): their effects look like those of constants."
    # A static model has no free response.
    elif resting and len(records) == len(nlp.parts) and not any(p.is_static for p in records):
        yield f"the inputs never change ({resting}): only the free response is informative."


def rounded_outputs(records: Sequence[FittedRecord]) -> Sentences:
    """Note outputs whose noise is smaller than half of their resolution."""
    return once(
        (
            f"{output} rounded",
            fitted.name,
            f"{output} in {fitted.name!r} is rounded more coarsely than its noise: rounding errors "
            "follow the signal, so that 95 % intervals cover 88 to 95 %.",
        )
        for fitted in records
        for output in fitted.outputs
        for values in [fitted.data[output]]
        if 2 * np.unique(values).size < np.isfinite(values).sum()
        and not is_resolved(fitted.residual(output), values)
    )
