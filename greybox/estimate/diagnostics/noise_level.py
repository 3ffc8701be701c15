"""Whether the noise is as large as stated, and whether the criterion uses what is stated.

Whether the errors of a response or of a manoeuvre are correlated along frequency.

Errors of neighboring points are correlated if the points are closer than the resolution of their
transform, or if the model misses a part of the response. Standard errors of responses account for
it (`greybox.statistics.neighbor_correlation`), and those of manoeuvres for disturbances
(`greybox.statistics.disturbed_errors`).

Whether the residuals of a simulation are process noise, such as gusts, or noise of sensors.

Gusts reach an output through the dynamics of the model, errors of a sensor do not: the likelihoods
of both were compared for the standard errors, see `greybox.statistics.residual_spectrum`.
"""

from collections import Counter
from collections.abc import Mapping
from contextlib import suppress

import numpy as np

from greybox.compiled.compiled_problem import AnyProblem
from greybox.compiled.part import Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.response_part import ResponsePart
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.intersample import SPACING
from greybox.estimate.covariance import Accuracy
from greybox.estimate.diagnostics.records import gust_criterion
from greybox.estimate.diagnostics.repeated import Finding, Findings, once
from greybox.estimate.fitted_part import FittedResponse
from greybox.estimate.result import Fit
from greybox.files.arrays import by_name
from greybox.files.text_table import Sentences, counted, percent, some
from greybox.statistics.neighbor_correlation import UNLIKELY
from greybox.statistics.residual_spectrum import VERY_STRONG

# Squared residuals over given variances below which these are doubted, or include other errors.
LEAST_RATIO = 0.4

# Degrees of freedom below which residuals hardly have a spectrum: with at most four, 4 to 12 % of
# 80 right models in white noise had "gusts", with six and more 1 to 4 %.
LEAST_FREEDOM = 6


def unlikely_noise(accuracy: Accuracy) -> Sentences:
    """Warn where the residuals are far from the noise that was given with the data."""
    nlp, trajectories = accuracy.nlp, accuracy.trajectories
    findings: list[Finding] = []
    parts = [part for part in nlp.parts if not part.problem.criterion.is_prior]
    # The unknowns use up degrees of freedom of all parts, not the same number in each.
    total = max(sum(part.numbers for part in parts), 1)
    remaining = 1 - len(nlp.free) / total
    shared = Counter[str]()
    for part in nlp.parts_of(RecordPart):
        shared.update(by_name(part.outputs, part.few.tolist()))
    for part, trajectory in nlp.rows_of(ResponsePart, trajectories):
        findings += _of_response(part, trajectory, remaining, 0.01 / len(parts))
    for part, trajectory in nlp.rows_of(RecordPart, trajectories):
        findings += _of_record(part, trajectory, remaining, total, shared)
    return once(iter(findings))


def _of_response(
    part: ResponsePart, trajectory: Trajectory, remaining: float, level: float
) -> Findings:
    if not part.criterion.known_noise:
        return
    dof = max(part.numbers * remaining, 1.0)
    ratio = part.noise_ratio(trajectory) * part.numbers / dof
    if _is_likely(ratio, dof, level):
        return

    # Estimated variances may include systematic errors, which the parameters take up.
    if ratio < 1 and part.data.dof is not None:
        return

    meaning = "the variances are too large"
    if ratio > 1:
        meaning = (
            "the model is incomplete or the variances are too small; the standard errors use the "
            "variance of the residuals"
        )

    yield (
        meaning,
        part.name,
        f"the residuals of {part.name!r} are {ratio:.2g} times as large as the given variances: "
        f"{meaning}.",
    )


def _is_likely(ratio: float, dof: float, level: float) -> bool:
    """Return whether given variances may leave such a mean square of residuals over them."""
    from scipy.special import chdtr, chdtrc  # noqa: PLC0415  (takes a tenth of a second to import)

    chance = min(chdtr(dof, ratio * dof), chdtrc(dof, ratio * dof))
    # Variances are hardly known better than to a factor of two.
    return chance > level or LEAST_RATIO <= ratio <= 2.5


def _of_record(
    part: RecordPart,
    trajectory: Trajectory,
    remaining: float,
    total: int,
    shared: Mapping[str, int],
) -> Findings:
    """Judge the outputs of a record; `total` numbers determine all unknowns.

    A share `remaining` of the numbers are degrees of freedom. Records share the variances of
    outputs with few samples, which have the `shared` number of them.
    """
    covariance, name = part.covariance, part.name
    if part.model.is_prior:
        return
    if covariance.known is None:
        counts = zip(part.outputs, part.few, covariance.counts, strict=True)
        least = min(shared[output] if few else n for output, few, n in counts if n)
        # With a single output, the intervals already allow for the number of samples.
        if least < min(6, total):
            text = (
                f"the noise of an output of {name!r} is estimated from {counted(least, 'sample')}, "
                "so that intervals may be too narrow: give it to the criterion, as noise={...}."
            )
            yield "few", name, text
        return
    columns = zip(
        part.outputs, covariance.known, trajectory.products, covariance.counts, strict=True
    )
    for k, (output, deviation, squares, count) in enumerate(columns):
        dof = max(count * remaining, 1.0)
        ratio = squares[k] / (dof * deviation**2)
        # The parameters may fit few samples exactly: then the given noise counts, not the
        # residuals.
        if (count < 8 and ratio < 1) or _is_likely(ratio, dof, 0.01 * count / total):
            continue
        incomplete = "the model is incomplete or the given value is too small"
        text = (
            f"the residual of {output} in {name!r} is {ratio**0.5:.2g} times the given standard "
            f"deviation: {incomplete if ratio > 1 else 'the given value is too large'}; the "
            "standard errors use the variance of the residuals."
        )
        yield f"{output} {ratio > 1}", name, text


def unused_noise(problem: AnyProblem) -> Findings:
    """Note responses whose variances or coherence the criterion does not use."""
    # In a sum with a likelihood, another criterion must be a likelihood, too.
    beside_likelihood = any(part.criterion.is_likelihood for part in problem.parts)
    for part in problem.parts_with(FrequencyResponse):
        uses, data = part.criterion.uses, part.data
        if uses is None:
            continue
        if data.variance is not None:
            if "variance" not in uses:
                text = (
                    f"the variances of {part.name!r} are not used: MaximumLikelihood() weights the "
                    "points by them."
                )
                yield "variance", part.name, text
        elif data.coherence is not None and "coherence" not in uses and not beside_likelihood:
            text = (
                f"the coherence of {part.name!r} is not used: MagnitudePhase() weights the points "
                "by it."
            )
            yield "coherence", part.name, text


def better_weights(accuracy: Accuracy) -> Sentences:
    """Note the weights of parts with which standard errors are clearly smaller.

    The cost weights errors as if they were independent and as large as given. Where they are not,
    the variance of a part's score, its meat, exceeds its bread. With each part's bread over its
    meat as its weight, parts count by their information.
    """
    if not accuracy.parts:
        return
    bread = np.array([errors.bread for errors in accuracy.parts])
    # A part may determine nothing.
    paid = np.linalg.trace(bread) + 1e-300
    variance = np.array([np.trace(errors.meat) for errors in accuracy.parts])
    # Correlation adds no information.
    weight = paid / np.maximum(variance, paid)
    better = np.linalg.inv(np.tensordot(weight, bread, 1))
    gain = np.sqrt(variance.sum() / max(np.trace(better), 1e-300))
    # A factor on standard errors: records of 60 samples with white errors have up to 1.1.
    if gain > 1.25:
        weights = [
            f"{part.weight * share:.2g} for {part.name!r}"
            for part, share in zip(accuracy.nlp.parts, weight, strict=True)
            if share < 0.5  # one is below 0.3, or the gain is smaller
        ]
        yield (
            "some parts have too much weight, because their errors are correlated or exceed the "
            f"given noise: with Problem(..., weight=...) of {some(weights)}, standard errors "
            f"would be about {gain:.2g} times smaller."
        )


def correlated_frequencies(accuracy: Accuracy) -> Sentences:
    """Name the responses whose errors at the estimate are correlated."""
    nlp = accuracy.nlp
    values = nlp.all_values(accuracy.x)
    unlikely = UNLIKELY / len(nlp.parts)
    for part, trajectory, known in nlp.rows_of(ResponsePart, accuracy.trajectories, accuracy.parts):
        is_stated = part.data.has_independent_errors
        errors = known.neighbors
        if is_stated:
            errors = part.neighbors(values, np.eye(len(nlp.free)), 1.0)
        if not errors or errors.independent >= unlikely:
            continue
        if is_stated:
            yield (
                f"neighboring residuals of {part.name!r} are alike "
                f"({errors.mean:.2f} from one point to the next), although its errors are "
                "stated to be independent: the model misses something, or slow changes of the "
                "vehicle or the air lasted for several tests. Without this statement, "
                "intervals allow for it."
            )
        # Variances that include more than the scatter, such as errors of a log, need no words.
        elif (
            not part.criterion.known_noise
            or part.data.dof is None
            or part.noise_ratio(trajectory) >= LEAST_RATIO
        ):
            # For 12 points with a correlation of 0.8, intervals of 95 % contain the truth in 86 to
            # 93 % of fits, for 24 points in 91 to 98 %.
            yield (
                f"the residuals of {part.name!r} are correlated along frequency "
                f"({errors.mean:.2f} from one point to the next; independent errors have a "
                "probability of "
                f"{percent(errors.independent)} %). Either the points are closer than the "
                "frequency resolution, or the model misses something; the standard errors "
                f"account for what {len(part.data)} points show of the first, but not for the "
                "second."
            )


def narrow_modes(answer: Fit) -> Findings:
    """Name modes that are too narrow for the spectra from which a response was estimated."""
    for k, part in enumerate(answer.parts):
        if not isinstance(part, FittedResponse) or SPACING not in part.data.about:
            continue
        poles = np.empty(0)
        with suppress(LookupError, ValueError):  # of a model without a rational form
            poles = answer.transfer_function(k).poles
        size, lines = np.abs(poles), 2 * np.abs(poles.real) / float(part.data.about[SPACING])
        is_measured = (part.data.omega.min() < size) & (size < part.data.omega.max())
        # Half-power widths in spectral lines. Below four, intervals of the damping held in 171 of
        # 201 fits of simulated sweeps and noise; in 82 of 85 from 4 to 6 lines, in 294 of 296
        # above.
        for mode in np.flatnonzero((poles.imag > 0) & is_measured & (lines < 4.0)):
            yield (
                "mode",
                part.name,
                f"the mode at {size[mode]:.3g} rad/s is {lines[mode]:.2g} spectral lines wide, too "
                f"narrow for the estimate of {part.name!r} (such 95 % intervals of a damping held "
                "in 84 % of simulated tests): fit the record itself, or fly longer.",
            )


def manoeuvre_warnings(accuracy: Accuracy) -> Sentences:
    """Name manoeuvres whose errors look like turbulence, which may bias an estimate."""
    for information in accuracy.informations:
        if information.disturbed:
            yield (
                f"the errors of {information.part.name!r} are larger in a part of the band, like "
                "those of turbulence, of noise of the outputs in equation error, or of a model "
                "that misses something. Intervals allow for the size of the errors, and not for a "
                "bias. For noise of the outputs, use OutputError(); in turbulence, "
                "EquationError(gusts=True) or, if that says the same, the record itself with "
                "PredictionError(process_noise=states) or PredictionError(disturbance={state: "
                "'colored'})."
            )


def gusts(accuracy: Accuracy, *, noisy: bool, explained: bool) -> Sentences:
    """Name the records with gusts and the criterion for them, and test sizes that ended at zero.

    Residuals of a wrong model look like gusts, unless noise is most of them.
    """
    rows = accuracy.nlp.rows_of(RecordPart, accuracy.trajectories, accuracy.parts)
    for part, trajectory, errors in rows:
        freedom = part.numbers - part.unknown_initial_states - len(accuracy.nlp.free)
        if part.is_static or errors.colored is None or freedom < LEAST_FREEDOM:
            continue
        steady, evidence = trajectory.detail.filter, errors.colored.process_noise
        if part.gains and (steady is None or steady.gain.any()):
            continue
        if noisy and part.problem.model.state_names and evidence() > VERY_STRONG:
            cure = "start process noise above zero" if part.gains else f"use {gust_criterion(part)}"
            like = (
                "not like noise of sensors:"
                if explained
                else "or like what the model lacks: mend the model first, and if they still do,"
            )
            yield f"the residuals of {part.name!r} look like gusts, {like} {cure}."
        elif part.gains:
            verdict = "show no process noise" if evidence() < 0 else "hardly show process noise"
            yield (
                f"these data {verdict}: w_{' and w_'.join(part.model.driven)} of {part.name!r} "
                "ended at zero, and OutputError has fewer unknowns."
            )
