"""Whether the errors of a response or of a manoeuvre are correlated along frequency.

Errors of neighboring points are correlated if the points are closer than the resolution of their
transform, or if the model misses a part of the response. Standard errors of responses account for
it (`greybox.statistics.neighbor_correlation`), those of manoeuvres do not.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import CorrelatedPoints, Trajectory
from greybox.compiled.response_part import ResponsePart
from greybox.compiled.transient_part import TransientPart
from greybox.estimate.covariance import Accuracy
from greybox.estimate.diagnostics.noise_level import LEAST_RATIO
from greybox.files.arrays import Array
from greybox.files.text_table import counted
from greybox.formulation.problem import Problem
from greybox.statistics.neighbor_correlation import neighbor_correlation

# Probability of independent errors below which a correlation is reported: in simulated fits of 10
# to 100 points it is reported in at most 1 % of those with independent errors.
UNLIKELY = 0.1

# Number of correlation lengths below which standard errors are called rough: for 12 points with a
# correlation of 0.8, two and a half lengths, intervals of 95 % contain the truth in 86 to 93 % of
# fits, for 24 points in 91 to 98 %.
FEWEST_LENGTHS = 8.0


def correlated_frequencies(
    nlp: CompiledProblem, trajectories: Sequence[Trajectory], accuracy: Accuracy
) -> Iterator[str]:
    """Name the responses and manoeuvres whose errors at the estimate are correlated."""
    for part, trajectory, neighbors in zip(
        nlp.parts, trajectories, accuracy.neighbors, strict=True
    ):
        if isinstance(part, TransientPart):
            yield from _of_manoeuvre(part, trajectory.z, alone=len(nlp.parts) == 1)
        elif isinstance(part, ResponsePart) and neighbors is not None:
            # Variances that include more than the scatter, such as errors of a log, need no words.
            is_estimated = part.criterion.known_noise and part.data.dof is not None
            if not (is_estimated and part.noise_ratio(trajectory) < LEAST_RATIO):
                yield from _of_response(part.problem, neighbors)


def _of_response(problem: Problem, neighbors: CorrelatedPoints) -> Iterator[str]:
    if neighbors.independent >= UNLIKELY:
        return
    text = _correlated(f"the residuals of {problem.name!r}", neighbors.correlation)
    points = len(problem.data)
    # Without enough lengths the correction itself is rough, which matters more than its reason.
    if neighbors.lengths < FEWEST_LENGTHS:
        yield (
            f"{text}; {counted(points, 'point')} whose errors stay correlated over "
            f"{points / neighbors.lengths:.1f} of them cannot show the size of slow errors, "
            "and the standard errors are rough."
        )
    else:
        yield f"{text}; the standard errors account for the first, not for the second."


def _of_manoeuvre(part: TransientPart, z: Array, *, alone: bool) -> Iterator[str]:
    of_problem = "" if alone else f" of {part.problem.name!r}"
    for output, errors, slope in part.errors_by_output(z):
        # Standard errors of manoeuvres are not corrected, other than those of responses.
        neighbors = neighbor_correlation(errors, np.vstack([slope.real, slope.imag]))
        if neighbors is not None and neighbors.independent < UNLIKELY:
            yield (
                f"{_correlated(f'the errors of {output}{of_problem}', neighbors.mean)}; "
                "the standard errors, which assume independent errors, are too small."
            )


def _correlated(errors: str, correlation: float) -> str:
    return (
        f"{errors} are correlated along frequency ({correlation:.2f} from one point to the next). "
        "Either the points are closer than the frequency resolution, or the model misses something"
    )
