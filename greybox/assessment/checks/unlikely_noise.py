"""Whether the residuals are as large as the noise that was given with the data."""

from collections import Counter
from collections.abc import Mapping

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.files.wording import counted
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.response_part import ResponsePart

# Squared residuals over given variances below which these are doubted, or include other errors.
LEAST_RATIO = 0.4


def unlikely_noise(evidence: Evidence) -> Findings:
    """Warn where the residuals are far from the noise that was given with the data."""
    nlp, trajectories = evidence.nlp, evidence.accuracy.trajectories
    parts = [part for part in nlp.parts if not part.problem.criterion.is_prior]
    # The unknowns use up degrees of freedom of all parts, not the same number in each.
    total = max(sum(part.numbers for part in parts), 1)
    remaining = 1 - len(nlp.free) / total
    shared = Counter[str]()
    for part in nlp.parts_of(RecordPart):
        shared.update(dict(zip(part.outputs, part.few.tolist(), strict=True)))
    for part, trajectory in nlp.rows_of(ResponsePart, trajectories):
        yield from _of_response(part, trajectory, remaining, 0.01 / len(parts))
    for part, trajectory in nlp.rows_of(RecordPart, trajectories):
        yield from _of_record(part, trajectory, remaining, total, shared)


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

    yield Finding(
        f"the residuals of {part.name!r} are {ratio:.2g} times as large as the given variances: "
        f"{meaning}.",
        meaning,
        part.name,
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
            yield Finding(text, "few", name)
        return
    columns = zip(
        part.outputs,
        np.sqrt(np.diag(covariance.known)),
        trajectory.products,
        covariance.counts,
        strict=True,
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
        yield Finding(text, f"{output} {ratio > 1}", name)
