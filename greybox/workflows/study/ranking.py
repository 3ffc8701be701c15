"""Which structure describes the data sets of a study best, by evidence and by held-out data."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from operator import attrgetter
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from greybox.assessment.result import Fit, Fits
from greybox.assessment.simulation.prediction import default_length
from greybox.assessment.simulation.simulate import predict
from greybox.assessment.validation.comparison import Comparison, Row
from greybox.assessment.validation.held_out import not_held_out
from greybox.assessment.validation.measures import fit_rows, information_rows
from greybox.assessment.validation.parsimony import parsimony
from greybox.assessment.validation.same_data import (
    count_unknowns,
    data_difference,
    is_likelihood,
    other_samples,
    why_not_comparable,
)
from greybox.data.files.grouping import unique
from greybox.data.files.numbers_in_text import percent
from greybox.data.files.wording import counted, some
from greybox.data.frequency_response import FrequencyResponse
from greybox.modeling.traced_once import unchanged
from greybox.statistics.metrics import rms

# Measures by which structures are compared; the first is the name of a row of `fit_rows`.
EVIDENCE = "BIC less the least"
PREDICTION = "error of held-out predictions, % of the signal"
# Relative difference of errors that makes no difference to a user of the model.
EQUAL = 0.05

# A number for every data set and structure; lower is better.
Table = dict[str, dict[str, float]]


class Result(NamedTuple):
    """The fit of a structure to a data set.

    Attributes
    ----------
    structure, data : str
        Their names.
    fit : Fit
    held_out : float or str or None
        Its `held_out_error`, if data are held out.
    """

    structure: str
    data: str
    fit: Fit
    held_out: float | str | None


# Equal models then share their compiled functions.
@unchanged()
def ranking(results: Iterable[Result]) -> Comparison:
    """Compare structures over data sets.

    The results of a data set follow each other: only the fits of one data set are in memory at a
    time.
    """
    tables: dict[str, Table] = {EVIDENCE: {}, PREDICTION: {}}
    sizes: dict[str, int] = {}
    notes: list[str] = []
    has_time = False
    for name, group in _by_data(results):
        best, tables[EVIDENCE][name] = _evidence(group)
        for structure, result in best.items():
            sizes[structure] = len(result.fit.free)
            has_time |= any(part.data.has_time for part in result.fit.records)
            error = result.held_out
            if isinstance(error, str):
                notes.append(f"{structure} does not predict the held-out data: {error}")
            elif error is not None:
                tables[PREDICTION].setdefault(name, {})[structure] = error

    if has_time:
        notes.append(
            "BIC assumes white residuals, which those of records seldom are: it then prefers "
            "structures with too many parameters, and held-out records decide."
        )
    rows = []
    wins = []
    verdicts = []
    for measure, table in tables.items():
        for name, values in table.items():
            rows.append(Row("study", measure, name, "", tuple(map(values.get, sizes))))
        if _best(table):
            wins.append(_wins(measure, table))
            verdicts.append(_verdict(measure, table, sizes))

    # The last verdict decides: that of held-out data, if there are any, which assumes nothing.
    return Comparison(
        tuple(sizes),
        f"{counted(len(tables[EVIDENCE]), 'data set')}: {some([*tables[EVIDENCE]])}",
        tuple(rows),
        unique([*wins, *notes]),
        supported=verdicts[-1][0] if verdicts else "",
        verdict=" ".join(text for _, text in verdicts),
    )


def _by_data(results: Iterable[Result]) -> Iterator[tuple[str, list[Result]]]:
    """Yield the names of data sets with their results.

    Different data of the same name are numbered.
    """
    for name, of_name in groupby(results, attrgetter("data")):
        groups: list[list[Result]] = []
        for result in of_name:
            for group in groups:
                if not data_difference([group[0].fit, result.fit], ("", "")):
                    group.append(result)
                    break
            else:
                groups.append([result])
        for number, group in enumerate(groups, 1):
            yield name if number == 1 else f"{name} {number}", group


def _evidence(group: Sequence[Result]) -> tuple[dict[str, Result], dict[str, float]]:
    """Return the best result of every structure, and its BIC less the least of all.

    Structures whose BIC is unknown are left out of the second mapping.
    """
    names = [result.structure for result in group]
    fits = [result.fit for result in group]
    rows, _ = fit_rows(fits, same_data=True, comparable=not why_not_comparable(fits, names))
    if all(fit.records and is_likelihood(fit) for fit in fits) and other_samples(fits, names):
        rows = _rows_of_shared_samples(fits)

    values = [math.inf] * len(fits)
    for row in rows:
        if row.measure == EVIDENCE:
            values = [math.inf if value is None else value for value in row.values]
            break
    best, least = {}, {}
    for name in unique(names):
        # Of equal values, the first counts.
        numbers = [k for k, structure in enumerate(names) if structure == name]
        k = min(numbers, key=values.__getitem__)
        best[name] = group[k]
        if values[k] < math.inf:
            least[name] = values[k]
    return best, least


def _rows_of_shared_samples(fits: Fits) -> list[Row]:
    """Return information criteria of fits of records, from the samples that all of them compare.

    A fit with a free delay leaves out the first samples. The errors of each output are taken as
    normal, with an estimated variance.
    """
    costs = np.zeros(len(fits))
    count = 0
    for parts in zip(*(fit.records for fit in fits), strict=True):
        for output in parts[0].outputs:
            residuals = np.array([part.residual(output) for part in parts])
            shared = residuals[:, np.isfinite(residuals).all(axis=0)]
            costs += shared.shape[1] / 2 * np.log(np.mean(shared**2, axis=1))
            count += shared.shape[1]
    return [*information_rows(costs.tolist(), [*map(count_unknowns, fits)], [count] * len(fits))]


def _best(table: Table) -> Counter[str]:
    """Return the number of data sets in which each structure is the best of several."""
    best: Counter[str] = Counter()
    for values in table.values():
        if len(values) > 1:
            best[min(values, key=values.__getitem__)] += 1
    return best


def _wins(measure: str, table: Table) -> str:
    """Return a sentence with the number of data sets in which each structure is the best."""
    wins = _best(table)
    texts = []
    for name, count in wins.most_common():
        texts.append(f"{name} in {count} ({percent(count / wins.total())} %)")
    return f"Best by {measure}, of {counted(wins.total(), 'data set')}: {', '.join(texts)}."


def _verdict(measure: str, table: Table, sizes: Mapping[str, int]) -> tuple[str, str]:
    """Return the structure that the data sets together support, and the reason.

    `sizes` are the numbers of free parameters.
    """
    # Not every structure was fitted to all data sets. Compared are the data sets of the structure
    # that is best most often, and the structures that were fitted to all of these.
    [(winner, _)] = _best(table).most_common(1)
    shared = [values for values in table.values() if winner in values]
    labels = [label for label in sizes if all(label in values for values in shared)]
    free = [sizes[label] for label in labels]
    # One row for each data set.
    values = np.array([[numbers[label] for label in labels] for numbers in shared])
    if measure == EVIDENCE:
        # Data sets are independent, so that their log-likelihoods, and with them BIC, add up.
        k, text = parsimony(labels, values.sum(axis=0).tolist(), free)
    else:
        # Means of logarithms: those of the errors are geometric.
        means = np.log(values).mean(axis=0).tolist()
        close_to_best = [k for k, mean in enumerate(means) if mean <= min(means) + EQUAL]
        k = min(close_to_best, key=lambda k: (free[k], means[k]))
        text = (
            f"{labels[k]} ({free[k]} free) is supported: it is the smallest whose errors of "
            f"held-out predictions are within {percent(EQUAL)} % of the least."
        )
    return labels[k], f"Over {counted(len(shared), 'data set')}, {text}"


def held_out_error(fit: Fit, held: Sequence[Any]) -> float | str:
    """Return the mean error of predictions of held-out data in percent, or why there is none."""
    try:
        return 100 * fmean(_error(fit, data) for data in held)
    except (ValueError, ArithmeticError, LookupError) as refusal:
        return str(refusal.args[-1])


def _error(fit: Fit, data: Any) -> float:
    """Return the relative error of the prediction of a response or a record.

    It is the rms of the relative residuals of a response, and the mean over the outputs of a
    record.
    """
    if isinstance(data, FrequencyResponse):
        pairs = [(part.data.input, part.data.output) for part in fit.responses]
        response = fit.response(data.omega, pairs.index((data.input, data.output))).response
        return rms(np.abs(response / data.response - 1))
    for text in not_held_out([fit], ["it"], [data]):
        raise ValueError(text)
    window = default_length([data], 1.0)  # as in `greybox.compare`
    prediction = predict(fit, record=data, horizon=window)
    return 1 - fmean(map(prediction.fit_percent, prediction.outputs)) / 100
