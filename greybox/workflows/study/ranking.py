"""Which structure describes the data sets of a study best, by evidence and by held-out data."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from statistics import fmean
from typing import Any

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

EVIDENCE = "BIC less the least"  # the row of `fit_rows`
PREDICTION = "error of held-out predictions, % of the signal"
EQUAL = 0.05  # relative difference of errors that makes no difference to a user of the model

# A number by data set and structure, the lower the better.
Table = dict[str, dict[str, float]]

# A structure, a data set, the fit, and its `held_out_error`, if data are held out.
Result = tuple[str, str, Fit, float | str | None]


@unchanged()  # equal models share what is compiled
def ranking(results: Iterable[Result]) -> Comparison:
    """Compare structures over data sets; each data set has its results in a row.

    Only the fits of one data set are in memory at a time.
    """
    tables: dict[str, Table] = {EVIDENCE: {}, PREDICTION: {}}
    sizes: dict[str, int] = {}
    notes: list[str] = []
    has_time = False
    for name, group in _by_data(results):
        best, tables[EVIDENCE][name] = _evidence(group)
        for structure, (fit, error) in best.items():
            sizes[structure] = len(fit.free)
            has_time |= any(part.data.has_time for part in fit.records)
            if isinstance(error, str):
                notes.append(f"{structure} does not predict the held-out data: {error}")
            elif error is not None:
                tables[PREDICTION].setdefault(name, {})[structure] = error

    # A likelihood of records assumes white residuals, and then prefers too many parameters.
    if has_time:
        notes.append(
            "BIC assumes white residuals, which those of records seldom are: it then prefers "
            "structures with too many parameters, and held-out records decide."
        )
    # Held-out data assume nothing, and have the last word.
    ranked = {measure: table for measure, table in tables.items() if _best(table)}
    verdicts = [_verdict(*pair, sizes) for pair in ranked.items()]
    rows = (
        Row("study", measure, name, "", tuple(map(values.get, sizes)))
        for measure, table in tables.items()
        for name, values in table.items()
    )
    return Comparison(
        tuple(sizes),
        f"{counted(len(tables[EVIDENCE]), 'data set')}: {some([*tables[EVIDENCE]])}",
        tuple(rows),
        unique([*(_wins(*pair) for pair in ranked.items()), *notes]),
        supported=verdicts[-1][0] if verdicts else "",
        verdict=" ".join(text for _, text in verdicts),
    )


def _by_data(results: Iterable[Result]) -> Iterator[tuple[str, list[Result]]]:
    """Yield data sets with their results."""
    for name, alike in groupby(results, itemgetter(1)):
        # Data of one name may differ: they are numbered.
        groups: list[list[Result]] = []
        for result in alike:
            matching = (g for g in groups if not data_difference([g[0][2], result[2]], ("", "")))
            if (group := next(matching, None)) is None:
                groups.append(group := [])
            group.append(result)
        for number, group in enumerate(groups, 1):
            yield name if number == 1 else f"{name} {number}", group


def _evidence(
    group: Sequence[Result],
) -> tuple[dict[str, tuple[Fit, float | str | None]], dict[str, float]]:
    """Return the best fit of every structure, and its BIC less the least of all."""
    names, _, fits, held = zip(*group, strict=True)
    rows, _ = fit_rows(fits, same_data=True, comparable=not why_not_comparable(fits, names))
    if all(fit.records and is_likelihood(fit) for fit in fits) and other_samples(fits, names):
        rows = _rows_of_shared_samples(fits)
    excess = next((row.values for row in rows if row.measure == EVIDENCE), [None] * len(fits))
    values = [math.inf if value is None else value for value in excess]
    order = sorted(range(len(fits)), key=values.__getitem__)
    first = {names[k]: k for k in reversed(order)}
    best = {name: (fits[first[name]], held[first[name]]) for name in unique(names)}
    return best, {name: values[first[name]] for name in best if values[first[name]] < math.inf}


def _rows_of_shared_samples(fits: Fits) -> list[Row]:
    """Return information criteria of fits of records, by the samples that all of them compare.

    A free delay leaves out the first samples. The errors of each output are normal, with a variance
    that is estimated.
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
    """Return in how many data sets each structure is the best of several."""
    contests = [values for values in table.values() if len(values) > 1]
    return Counter(min(values, key=values.__getitem__) for values in contests)


def _wins(measure: str, table: Table) -> str:
    wins = _best(table)
    texts = (f"{name} in {n} ({percent(n / wins.total())} %)" for name, n in wins.most_common())
    return f"Best by {measure}, of {counted(wins.total(), 'data set')}: {', '.join(texts)}."


def _verdict(measure: str, table: Table, sizes: Mapping[str, int]) -> tuple[str, str]:
    """Return the structure that the data sets together support, and why."""
    # Not all structures suit all data sets: the comparison uses the data sets of the structure that
    # is best most often.
    [(winner, _)] = _best(table).most_common(1)
    shared = [values for values in table.values() if winner in values]
    labels = [label for label in sizes if all(label in values for values in shared)]
    free = [sizes[label] for label in labels]
    values = np.array([[numbers[label] for label in labels] for numbers in shared])
    if measure == EVIDENCE:
        # Data sets are independent, so that their log-likelihoods, and with them BIC, add up.
        k, text = parsimony(labels, values.sum(axis=0).tolist(), free)
    else:
        means = np.log(values).mean(axis=0).tolist()
        alike = [k for k, mean in enumerate(means) if mean <= min(means) + EQUAL]
        k = min(alike, key=lambda k: (free[k], means[k]))
        text = (
            f"{labels[k]} ({free[k]} free) is supported: it is the smallest whose errors of "
            f"held-out predictions are within {percent(EQUAL)} % of the least."
        )
    return labels[k], f"Over {counted(len(shared), 'data set')}, {text}"


def held_out_error(fit: Fit, held: Sequence[Any]) -> float | str:
    """Return the mean error of predictions of records and responses in percent, or why not."""
    try:
        return 100 * fmean(_error(fit, data) for data in held)
    except (ValueError, ArithmeticError, LookupError) as refusal:
        return str(refusal.args[-1])


def _error(fit: Fit, data: Any) -> float:
    """Return the relative residuals (rms) of a response, or the mean of all outputs of a record."""
    if isinstance(data, FrequencyResponse):
        pairs = [(part.data.input, part.data.output) for part in fit.responses]
        response = fit.response(data.omega, pairs.index((data.input, data.output))).response
        return rms(np.abs(response / data.response - 1))
    for text in not_held_out([fit], ["it"], [data]):
        raise ValueError(text)
    window = default_length([data], 1.0)  # as in `greybox.compare`
    prediction = predict(fit, record=data, horizon=window)
    return 1 - fmean(map(prediction.fit_percent, prediction.outputs)) / 100
