"""Whether the noise is as large as stated, and whether the criterion uses what is stated."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from greybox.compiled.compiled_problem import AnyProblem, CompiledProblem
from greybox.compiled.part import Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.response_part import ResponsePart
from greybox.data.frequency_response import FrequencyResponse
from greybox.estimate.diagnostics.repeated import Finding, once
from greybox.files.text_table import counted

# Squared residuals over given variances below which these are doubted, or include other errors.
LEAST_RATIO = 0.4


def unlikely_noise(nlp: CompiledProblem, trajectories: Sequence[Trajectory]) -> Iterator[str]:
    """Warn where the residuals are far from the noise that was given with the data."""
    findings: list[Finding] = []
    parts = [part for part in nlp.parts if not part.problem.criterion.is_prior]
    # The unknowns use up degrees of freedom of all parts, not the same number in each.
    total = max(sum(part.numbers for part in parts), 1)
    remaining = 1 - len(nlp.free) / total
    shared = Counter[str]()
    for part in nlp.parts:
        if isinstance(part, RecordPart):
            shared.update(dict(zip(part.outputs, part.few.tolist(), strict=True)))
    for part, trajectory in zip(nlp.parts, trajectories, strict=True):
        if isinstance(part, ResponsePart):
            findings += _of_response(part, trajectory, remaining, 0.01 / len(parts))
        elif isinstance(part, RecordPart):
            findings += _of_record(part, trajectory, len(nlp.free), total, shared)
    return once(findings)


def _of_response(
    part: ResponsePart, trajectory: Trajectory, remaining: float, level: float
) -> Iterator[Finding]:
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
        "incomplete" if ratio > 1 else "too large",
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
    unknowns: int,
    total: int,
    shared: Mapping[str, int],
) -> Iterator[Finding]:
    """Judge the outputs of a record; `total` numbers determine all unknowns.

    Records share the variances of outputs with few samples, which have the `shared` number of them.
    """
    covariance, name = part.covariance, part.model.record.name or part.name
    if part.model.is_prior:
        return
    if covariance.known is None:
        counts = zip(part.outputs, part.few, covariance.counts, strict=True)
        least = min(shared[output] if few else n for output, few, n in counts if n)
        # Of one output alone, the intervals allow for the number of samples.
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
        dof = max(count * (1 - unknowns / total), 1.0)
        ratio = squares[k] / (dof * deviation**2)
        # The parameters may fit few samples exactly: then the given noise counts, not theirs.
        if (count < 8 and ratio < 1) or _is_likely(ratio, dof, 0.01 * count / total):
            continue
        incomplete = "the model is incomplete or the given value is too small"
        text = (
            f"the residual of {output} in {name!r} is {ratio**0.5:.2g} times the given standard "
            f"deviation: {incomplete if ratio > 1 else 'the given value is too large'}; the "
            "standard errors use the variance of the residuals."
        )
        yield f"{output} {ratio > 1}", name, text


def unused_noise(problem: AnyProblem) -> Iterator[str]:
    """Note responses whose variances or coherence the criterion does not use."""
    # In a sum with a likelihood, another criterion must be a likelihood, too.
    beside_likelihood = any(part.criterion.is_likelihood for part in problem.parts)
    for part in problem.parts_with(FrequencyResponse):
        uses, data = part.criterion.uses, part.data
        if uses is None:
            continue
        if data.variance is not None:
            if "variance" not in uses:
                yield (
                    f"the variances of {part.name!r} are not used: MaximumLikelihood() weights the "
                    "points by them."
                )
        elif data.coherence is not None and "coherence" not in uses and not beside_likelihood:
            yield (
                f"the coherence of {part.name!r} is not used: MagnitudePhase() weights the points "
                "by it."
            )
