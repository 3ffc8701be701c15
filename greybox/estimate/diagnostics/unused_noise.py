"""Whether the data say how large their errors are, and the criterion does not use it."""

from collections.abc import Iterator

from greybox.compiled.compiled_problem import AnyProblem
from greybox.formulation.frequency_criteria import Criterion


def unused_noise(problem: AnyProblem) -> Iterator[str]:
    """Name the responses whose variances or coherence the criterion does not use, and a criterion that would."""
    beside_likelihood = any(part.criterion.is_likelihood for part in problem.parts)
    for part in problem.parts:
        if not isinstance(part.criterion, Criterion) or part.criterion.uses is None:
            continue
        uses, data = part.criterion.uses, part.response
        if data.variance is not None and "variance" not in uses:
            yield f"the variances of {part.name!r} are not used: MaximumLikelihood() would weigh its points by them."
        elif (
            data.variance is None
            and data.coherence is not None
            and "coherence" not in uses
            and not beside_likelihood
        ):
            yield f"the coherence of {part.name!r} is not used: MagnitudePhase() would weigh its points by it."
