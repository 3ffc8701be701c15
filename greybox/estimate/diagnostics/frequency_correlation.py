"""Whether the errors of a response or of a manoeuvre are correlated along frequency.

Errors of neighboring points are correlated if the points are closer than the resolution of their
transform, or if the model misses a part of the response. Standard errors of responses account for
it (`greybox.statistics.neighbor_correlation`), and manoeuvres then have none.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Trajectory
from greybox.compiled.response_part import ResponsePart
from greybox.estimate.covariance import Accuracy
from greybox.estimate.diagnostics.noise_level import LEAST_RATIO
from greybox.estimate.result import Fit
from greybox.files.arrays import Array
from greybox.files.text_table import percent, some
from greybox.statistics.neighbor_correlation import UNLIKELY


def correlated_frequencies(
    nlp: CompiledProblem,
    trajectories: Sequence[Trajectory],
    accuracy: Accuracy,
    x: Array,
) -> Iterator[str]:
    """Name the responses whose errors at the estimate x (p,) are correlated."""
    values, unlikely = nlp.all_values(x), UNLIKELY / len(nlp.parts)
    for part, trajectory, known in nlp.rows_of(ResponsePart, trajectories, accuracy.parts):
        if part.data.has_independent_errors:
            errors = part.neighbors(values, np.eye(len(nlp.free)), 1.0)
            if errors is not None and errors.independent < unlikely:
                yield (
                    f"neighboring residuals of {part.name!r} are alike "
                    f"({errors.mean:.2f} from one point to the next), although its errors are "
                    "stated to be independent: the model misses something, or slow changes of the "
                    "vehicle or the air lasted for several tests. Without this statement, "
                    "intervals allow for it."
                )
        elif known.neighbors is not None:
            errors = known.neighbors.errors
            # Variances that include more than the scatter, such as errors of a log, need no words.
            is_estimated = part.criterion.known_noise and part.data.dof is not None
            has_more = is_estimated and part.noise_ratio(trajectory) < LEAST_RATIO
            if errors.independent < unlikely and not has_more:
                # For 12 points with a correlation of 0.8, intervals of 95 % contain the truth in 86
                # to 93 % of fits, for 24 points in 91 to 98 %.
                yield (
                    f"the residuals of {part.name!r} are correlated along frequency "
                    f"({errors.mean:.2f} from one point to the next; independent errors have a "
                    "probability of "
                    f"{percent(errors.independent)} %). Either the points are closer than the "
                    "frequency resolution, or the model misses something; the standard errors "
                    f"account for what {len(part.data)} points show of the first, but not for the "
                    "second."
                )


def doubtful_manoeuvres(accuracy: Accuracy) -> Iterator[str]:
    """Name the manoeuvres whose errors leave a fit without intervals."""
    for information in accuracy.informations:
        if information.doubtful:
            yield (
                f"the errors of {some(information.doubtful)} of {information.part.name!r} "
                "are larger at low or at high frequencies, or correlated along frequency, like "
                "those of turbulence, of noise of the outputs in equation error, or of a model "
                "that misses something. Intervals would be too narrow, so there are none. For "
                "noise of the outputs, use OutputError(); in turbulence, EquationError(gusts=True) "
                "or, if that says the same, the record itself with "
                "PredictionError(process_noise=states) or PredictionError(disturbance={state: "
                "'colored'})."
            )


def uncertain_gusts(answer: Fit) -> Iterator[str]:
    """Name the time constants of gusts that manoeuvres leave open: all intervals depend on them."""
    if not answer.spectra or answer.directions is None:
        return
    for name, (low, _) in answer.interval().items():
        if name.startswith("T_gust") and not low > 0:
            yield (
                f"the data hardly determine {name}, the time constant of the gusts, on which all "
                "intervals depend: they may be too narrow (95 % intervals of one manoeuvre of 8 s "
                "covered 83 to 96 % in simulated turbulence). Repeat the manoeuvre."
            )
