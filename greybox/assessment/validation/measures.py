"""The rows of a comparison's table: information criteria, and measures of predictions.

Fits of frequency responses may have different criteria. AIC and BIC then belong to one likelihood,
which is maximized from every estimate.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from greybox.assessment.fit import SolverChoice
from greybox.assessment.fitted_part import FittedResponse
from greybox.assessment.fitted_problem import problem_of
from greybox.assessment.result import Fit, Fits
from greybox.assessment.simulation.prediction import Prediction
from greybox.assessment.validation.comparison import Row
from greybox.assessment.validation.held_out import Predictions
from greybox.assessment.validation.same_data import count_unknowns, is_likelihood
from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.json_numbers import finite
from greybox.engine.solve.multistart import multistart
from greybox.modeling.formulation.frequency_criteria import (
    Criterion,
    MaximumLikelihood,
    RelativeLikelihood,
)
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.statistics.correlation_statistics import whiteness
from greybox.statistics.metrics import fit_percent, rms


@frozen
class Likelihoods:
    """The fits of a comparison on the scale of one likelihood.

    Attributes
    ----------
    criterion : Criterion
        The likelihood.
    originals : tuple of Fit
        The fits, by any criterion.
    least : tuple of float or None
        Negative log-likelihood at the minimum next to each estimate; None where it is not known.
    """

    criterion: Criterion
    originals: tuple[Fit, ...]
    least: tuple[float | None, ...]

    @property
    def costs(self) -> list[float]:
        """Negative log-likelihoods, up to a constant of the data."""
        pairs = zip(self.least, self.originals, strict=True)
        name = self.criterion.name
        return [fit.costs[name] if cost is None else cost for cost, fit in pairs]

    @property
    def unknowns(self) -> list[int]:
        """Numbers of free parameters and noise variances."""
        return [len(fit.free) + self.criterion.nuisances * len(fit.parts) for fit in self.originals]


def common_likelihood(fits: Fits, *, comparable: bool) -> Likelihoods | None:
    """Return fits to the same responses on the scale of one likelihood.

    None for other data or weights, and if costs are likelihoods that are `comparable` as they are.
    """
    if comparable and all(map(is_likelihood, fits)):
        return None
    parts = [part for fit in fits for part in fit.parts]
    if not all(isinstance(part, FittedResponse) and part.weight == 1 for part in parts):
        return None
    # Measured variances, where all data have them, are better than the assumption that errors are
    # proportional to the response.
    has_variances = all(part.data.variance is not None for part in fits[0].responses)
    criterion = MaximumLikelihood() if has_variances else RelativeLikelihood()
    return Likelihoods(criterion, tuple(fits), tuple(_least_cost(fit, criterion) for fit in fits))


@one_thread_at_a_time  # also frees what it compiles
def _least_cost(fit: Fit, criterion: Criterion) -> float | None:
    """Return the cost at the minimum of this criterion next to the estimate, if it is found.

    A fit would judge the minimum too, which takes several times as long.
    """
    if all(part.criterion_class == criterion.class_path for part in fit.parts):
        return fit.cost
    try:
        problem = problem_of(fit).with_(criterion=criterion)
    except (LookupError, ValueError):
        return None
    solver = SolverChoice().solver(problem)
    start = np.array([[fit.estimate[name] for name in solver.nlp.free]])
    minima = solver.polished(multistart(solver, start)).minima
    is_found = minima and minima[0].cost <= fit.costs[criterion.name]
    return minima[0].cost if is_found else None


def fit_rows(
    fits: Fits,
    *,
    same_data: bool,
    comparable: bool,
) -> tuple[list[Row], Likelihoods | None]:
    """Return the rows of the fits as a whole, costs, sizes, AIC, AICc and BIC, and likelihoods.

    Costs are in the table if they are `comparable`; information criteria if costs are likelihoods,
    or if the fits have common likelihoods.
    """
    likelihoods = common_likelihood(fits, comparable=comparable) if same_data else None
    names = unique(fit.criterion for fit in fits)
    criterion = names[0] if len(names) == 1 else "negative log-likelihood"
    costs = [fit.cost for fit in fits]
    numbers = [sum(part.compared_numbers for part in fit.parts) for fit in fits]
    unknown = [math.nan] * len(fits)

    rows = [
        _row(f"cost: {criterion}", costs) if comparable else _row("cost", unknown),
        _row("free parameters", [len(fit.free) for fit in fits]),
        _row("numbers in the data", numbers),
        _row("degrees of freedom", [fit.dof for fit in fits]),
    ]
    if likelihoods is not None:
        rows += [_row("negative log-likelihood", likelihoods.costs)]
        rows += information_rows(likelihoods.costs, likelihoods.unknowns, numbers)
    else:
        is_known = comparable and all(map(is_likelihood, fits))
        unknowns = [count_unknowns(fit) for fit in fits]
        rows += information_rows(costs if is_known else unknown, unknowns, numbers)
    if same_data and not comparable:
        for name in names:
            rows.append(_row(f"cost: {name}", [f.costs.get(name, math.nan) for f in fits]))
    if same_data and all(fit.responses for fit in fits):
        sizes = [100 * relative_rms(fit) for fit in fits]
        rows.append(_row("relative residual (rms)", sizes, "%"))
    # A reader looks for costs, AIC and BIC: dashes show that they are not known.
    always_shown = ("cost", "AIC", "BIC")
    return [row for row in rows if row.measure in always_shown or row.is_known], likelihoods


def information_rows(
    costs: Sequence[float], unknowns: Sequence[int], numbers: Sequence[int]
) -> Iterator[Row]:
    """Yield AIC, AICc and BIC for k unknowns and n numbers, and their differences from the least.

    Source: Burnham and Anderson (2002), section 2.4.
    """
    criteria: dict[str, list[float]] = {"AIC": [], "AICc": [], "BIC": []}
    for k, n, cost in zip(unknowns, numbers, costs, strict=True):
        # AIC = 2 k - 2 ln L and BIC = k ln n - 2 ln L. AICc adds 2 k (k + 1) / (n - k - 1), which
        # makes 2 k n / (n - k - 1) of the first term; it does not exist for n <= k + 1.
        corrected = 2.0 * k * n / (n - k - 1) if n > k + 1 else math.nan
        criteria["AIC"].append(2.0 * k + 2 * cost)
        criteria["AICc"].append(corrected + 2 * cost)
        criteria["BIC"].append(k * math.log(n) + 2 * cost)

    for name, values in criteria.items():
        least = np.nanmin([*values, math.inf])
        yield _row(name, values)
        yield _row(f"{name} less the least", [value - least for value in values])


def relative_rms(fit: Fit) -> float:
    """Return the size (rms) of the residuals of all responses over that of the data."""
    return rms(np.concatenate([part.relative_residuals for part in fit.responses]))


def _row(measure: str, values: Sequence[float], unit: str = "") -> Row:
    """Return a row on the fits as a whole."""
    return Row("fit", "", measure, unit, tuple(map(finite, values)))


def prediction_rows(kind: str, predictions: Predictions, fits: Fits) -> Iterator[Row]:
    """Yield the measures of every output over all windows of all records of a `kind` of data."""
    estimated = [sum(len(p.own) for p in of_fit) for of_fit in predictions]
    if any(estimated):
        text = "values estimated from the records"
        yield Row(kind, "", text, "", tuple(map(finite, estimated)))
    for output in unique(name for p in predictions[0] for name in p.outputs):
        pairs = zip(predictions, fits, strict=True)
        measures_of_fits = [_measures(output, of_fit, fit) for of_fit, fit in pairs]
        # All fits have the same measures.
        for measure, unit in measures_of_fits[0]:
            values = [measures[measure, unit] for measures in measures_of_fits]
            yield Row(kind, output, measure, unit, tuple(map(finite, values)))


def _measures(
    output: str, predictions: Sequence[Prediction], fit: Fit
) -> dict[tuple[str, str], float]:
    """Return the measures of an output over all samples that a fit predicts, by name and unit."""
    with_output = [p for p in predictions if output in p.outputs]
    measured = np.concatenate([p.measured(output).ravel() for p in with_output])
    predicted = np.concatenate([p.predicted[p.outputs.index(output)].ravel() for p in with_output])
    # Errors further ahead are correlated even for the true model; those one step ahead are white.
    errors: list[Array] = []
    for p in with_output:
        errors += _in_time_order(p, output)
    size = rms(np.concatenate(errors))
    measures = {
        ("fit", "%"): fit_percent(measured, predicted),
        ("error (rms)", with_output[0].data.units.get(output, "")): rms(measured - predicted),
    }
    if not any(p.data.has_time for p in with_output):
        return measures | {("error over noise", ""): size}
    # Gains are fitted such that the first correlations vanish: the test must not count these.
    gains = max((part.innovation_parameters(output) for part in fit.records), default=0)
    return measures | {
        ("one step ahead: error over noise", ""): size,
        ("  white (p)", ""): whiteness(errors, fitted=gains).p_value,
    }


def _in_time_order(prediction: Prediction, output: str) -> list[Array]:
    """Return the errors one step ahead along the record, NaN between windows, cut at its gaps."""
    along = np.full(len(prediction.data), np.nan)
    errors = prediction.one_step[prediction.outputs.index(output)]
    is_sample = prediction.rows >= 0
    along[prediction.rows[is_sample]] = errors[is_sample]
    return [along[rows] for rows in prediction.data.independent_pieces]
