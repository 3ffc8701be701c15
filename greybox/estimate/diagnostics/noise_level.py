"""Whether the noise is of the size that was assumed, and small enough for the criterion."""

from collections.abc import Iterator, Sequence
from functools import singledispatch

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Part, Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.response_part import ResponsePart
from greybox.estimate.covariance import Accuracy
from greybox.estimate.diagnostics.repeated import Found, once

# Relative noise of a component from which the bias of the gain (`gain_bias`) reaches 1 %.
NOISY = 0.1

# Ratio of the residual variance to the given one that noise alone does not explain: with 10 degrees
# of freedom chi-square over these lies between 0.4 and 2.5 in 94 % of all cases, with more of them
# far more often.
LEAST_VARIANCE_RATIO = 0.4
LARGEST_VARIANCE_RATIO = 2.5

# The same of standard deviations.
LEAST_DEVIATION_RATIO = 0.6
LARGEST_DEVIATION_RATIO = 1.6


def biased_gains(nlp: CompiledProblem, accuracy: Accuracy) -> Iterator[str]:
    """Say by how much the normalization of a relative criterion biases the gain, where the noise is large."""
    for part, noise in zip(nlp.parts, accuracy.noise, strict=True):
        bias = part.problem.criterion.gain_bias(noise, part.numbers // 2) if noise > NOISY else 0.0
        if bias:
            other = "model" if bias < 0 else "measured"
            yield (
                f"the residual of {part.name!r} is {100 * noise:.0f} % rms in each component: if that is noise, the "
                f"gain is about {100 * abs(bias):.0f} % too {'low' if bias < 0 else 'high'}, for which intervals "
                f"allow; compare with normalized='{other}', which errs in the other direction."
            )


def unlikely_noise(nlp: CompiledProblem, trajectories: Sequence[Trajectory]) -> Iterator[str]:
    """Say where the noise that was given with the data is far from what the residuals show."""
    found: list[Found] = []
    for part, trajectory in zip(nlp.parts, trajectories, strict=True):
        found += unlikely_noise_of(part, trajectory, len(nlp.free))
    return once(found)


@singledispatch
def unlikely_noise_of(part: Part, trajectory: Trajectory, unknowns: int) -> Iterator[Found]:
    """Say so of one part of a problem with so many unknowns."""
    yield from ()


@unlikely_noise_of.register
def _(part: ResponsePart, trajectory: Trajectory, unknowns: int) -> Iterator[Found]:
    if not part.criterion.known_noise:
        return
    points = part.numbers / 2
    ratio = part.noise_ratio(trajectory) * points / max(points - unknowns / 2, 0.5)
    if LEAST_VARIANCE_RATIO <= ratio <= LARGEST_VARIANCE_RATIO:
        return
    meaning = "the variances are too large."
    if ratio > 1:
        meaning = "the model is incomplete or the variances are too small; standard errors use the residual variance."
    text = f"the residuals of {part.name!r} are {ratio:.2g} times what the given variances say: {meaning}"
    yield "incomplete" if ratio > 1 else "too large", part.name, text


@unlikely_noise_of.register
def _(part: RecordPart, trajectory: Trajectory, unknowns: int) -> Iterator[Found]:
    if part.covariance.known is None or part.problem.criterion.is_prior:
        return
    deviations = np.sqrt(np.diag(trajectory.products) / np.maximum(part.covariance.counts, 1))
    for output, given, residual in zip(
        part.outputs, part.covariance.known, deviations, strict=True
    ):
        ratio = residual / given
        if not LEAST_DEVIATION_RATIO <= ratio <= LARGEST_DEVIATION_RATIO:
            name = part.model.record.name or part.name
            text = (
                f"the residual of {output} in {name!r} is {ratio:.2g} times the given standard deviation: the "
                "model is incomplete or the stated value is wrong; standard errors use the residual variance."
            )
            yield f"{output} {ratio > 1}", name, text
