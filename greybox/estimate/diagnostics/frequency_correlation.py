"""Whether the errors of a response or of a manoeuvre are correlated along frequency.

Errors of neighboring points are correlated if the points are closer than the resolution of their
transform, or if the model misses a part of the response. Standard errors of responses account for
it (`greybox.statistics.neighbor_correlation`), those of manoeuvres do not.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Trajectory
from greybox.compiled.response_part import ResponsePart
from greybox.compiled.transient_part import TransientPart
from greybox.estimate.covariance import Accuracy
from greybox.estimate.diagnostics.noise_level import LEAST_RATIO
from greybox.files.arrays import Array
from greybox.files.text_table import percent
from greybox.statistics.neighbor_correlation import NeighborCorrelation, neighbor_correlation
from greybox.statistics.score_test import scores_of_powers

# Probability of independent errors below which a correlation is reported: in simulated fits of 10
# to 100 points it is reported in at most 1 % of those with independent errors.
UNLIKELY = 0.1

# Difference of -2 log evidence from which errors look like turbulence: in simulated manoeuvres of 8
# s it was reported in 3 of 280 fits without gusts, and by output error in 158 of 160 with them.
STRONG = 6.0


def correlated_frequencies(
    nlp: CompiledProblem,
    trajectories: Sequence[Trajectory],
    accuracy: Accuracy,
    x: Array,
) -> Iterator[str]:
    """Name the responses and manoeuvres whose errors at the estimate x (p,) are correlated."""
    values, unlikely = nlp.all_values(x), UNLIKELY / len(nlp.parts)
    known = [part.neighbors for part in accuracy.parts] or [None] * len(nlp.parts)
    for part, trajectory, neighbors in zip(nlp.parts, trajectories, known, strict=True):
        if isinstance(part, TransientPart):
            yield from _of_manoeuvre(part, trajectory.z, alone=len(nlp.parts) == 1)
        elif isinstance(part, ResponsePart) and part.data.has_independent_errors:
            errors = part.neighbors(values, np.eye(len(nlp.free)), 1.0)
            if errors is not None and errors.independent < unlikely:
                yield (
                    f"neighboring residuals of {part.problem.name!r} are alike "
                    f"({errors.mean:.2f} from one point to the next), although its errors are "
                    "stated to be independent: the model misses something, or slow changes of the "
                    "vehicle or the air lasted for several tests. Without this statement, "
                    "intervals allow for it."
                )
        elif isinstance(part, ResponsePart) and neighbors is not None:
            errors, name = neighbors.errors, part.problem.name
            # Variances that include more than the scatter, such as errors of a log, need no words.
            is_estimated = part.criterion.known_noise and part.data.dof is not None
            has_more = is_estimated and part.noise_ratio(trajectory) < LEAST_RATIO
            if errors.independent < unlikely and not has_more:
                # For 12 points with a correlation of 0.8, intervals of 95 % contain the truth in 86
                # to 93 % of fits, for 24 points in 91 to 98 %.
                yield (
                    f"{_correlated(f'the residuals of {name!r}', errors)}; the standard errors "
                    f"account for what {len(part.data)} points show of the first, but not for the "
                    "second."
                )


def _of_manoeuvre(part: TransientPart, z: Array, *, alone: bool) -> Iterator[str]:
    of_problem = "" if alone else f" of {part.problem.name!r}"
    for output, errors, complex_slope in part.errors_by_output(z):
        slope = np.vstack([complex_slope.real, complex_slope.imag])
        scores = scores_of_powers(np.hstack([errors.real, errors.imag]), slope, part.data.omega)
        # Strength of evidence: Kass and Raftery (1995), JASA 90.
        if scores[0] - scores.min() > STRONG:
            yield (
                f"the errors of {output}{of_problem} are larger at low frequencies, as in "
                "turbulence, and the intervals may be too narrow: if the model is complete, use "
                "EquationError(gusts=True)."
            )
        # Standard errors of manoeuvres are not corrected, other than those of responses.
        neighbors = neighbor_correlation(errors, slope)
        if neighbors is not None and neighbors.independent < UNLIKELY:
            yield (
                f"{_correlated(f'the errors of {output}{of_problem}', neighbors)}; "
                "the standard errors, which assume independent errors, are too small."
            )


def _correlated(errors: str, neighbors: NeighborCorrelation) -> str:
    return (
        f"{errors} are correlated along frequency ({neighbors.mean:.2f} from one point to the "
        f"next; independent errors have a probability of {percent(neighbors.independent)} %). "
        "Either the points are closer than the frequency resolution, or the model misses something"
    )
