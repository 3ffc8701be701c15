"""Which structure describes the data sets of a study best, by evidence and by held-out records."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from greybox.data.record import Record
from greybox.estimate.result import Fit
from greybox.files.text_table import counted, percent, some
from greybox.validation.common_likelihood import common_likelihood
from greybox.validation.comparison import HELD_OUT, Comparison, Row
from greybox.validation.held_out import not_held_out, predict_same_windows, window_lengths
from greybox.validation.measures import fit_rows, prediction_rows
from greybox.validation.parsimony import parsimony
from greybox.validation.same_data import data_difference, is_likelihood, why_not_comparable

EVIDENCE = "BIC less the least"  # the row of `fit_rows`
PREDICTION = "error of held-out predictions, % of the signal"

Records = Sequence[Record] | Mapping[str, Sequence[Record]]
Table = dict[str, dict[str, float]]
"""A number by data set and structure, the less the better."""


def ranking(
    fits: Sequence[tuple[str, str, Fit]],
    records: Records = (),
    window: float | None = None,
    lead: float | None = None,
) -> Comparison:
    """Compare structures over data sets; `fits` are (structure, data set, fit)."""
    tables: dict[str, Table] = {EVIDENCE: {}, PREDICTION: {}}
    sizes: dict[str, int] = {}
    notes: list[str] = []
    for name, group in _by_data(fits).items():
        best, tables[EVIDENCE][name] = _evidence(group)
        sizes |= {structure: len(fit.free) for structure, fit in best.items()}
        chosen = records.get(name, ()) if isinstance(records, Mapping) else records
        if chosen:
            notes += not_held_out([*best.values()], [*best], chosen)
            try:
                tables[PREDICTION][name] = _errors(best, chosen, (window, lead))
            except (ValueError, ArithmeticError, LookupError) as error:  # others may be predicted
                notes.append(f"{name}: {error}")

    # A likelihood of records assumes white residuals, and then prefers too many parameters.
    if any(part.data.has_time for _, _, fit in fits for part in fit.records):
        notes.append(
            "BIC assumes white residuals, which those of records seldom are: it then prefers "
            "structures with too many parameters, and held-out records decide."
        )
    supported, verdict = _verdict(tables[EVIDENCE], sizes)
    return Comparison(
        tuple(sizes),
        f"{counted(len(tables[EVIDENCE]), 'data set')}: {some([*tables[EVIDENCE]])}",
        tuple(
            Row("study", measure, name, "", tuple(map(values.get, sizes)))
            for measure, table in tables.items()
            for name, values in table.items()
        ),
        tuple(dict.fromkeys([*(_wins(*pair) for pair in tables.items() if pair[1]), *notes])),
        supported=supported,
        verdict=verdict,
    )


def _by_data(fits: Sequence[tuple[str, str, Fit]]) -> dict[str, list[tuple[str, Fit]]]:
    """Return the fits with their structures by data set."""
    groups: dict[str, list[tuple[str, Fit]]] = {}
    for structure, name, fit in fits:
        # Data of one name may differ: they are numbered.
        key, number = name, 1
        while key in groups and data_difference([groups[key][0][1], fit], ("", "")):
            number += 1
            key = f"{name} {number}"
        groups.setdefault(key, []).append((structure, fit))
    return groups


def _evidence(group: Sequence[tuple[str, Fit]]) -> tuple[dict[str, Fit], dict[str, float]]:
    """Return the best fit of every structure, and its BIC less the least of all."""
    names, fits = zip(*group, strict=True)
    is_comparable = not why_not_comparable(fits, names)
    likelihoods = None
    if not is_comparable or not all(map(is_likelihood, fits)):
        likelihoods = common_likelihood(fits)
    rows = fit_rows(fits, same_data=True, comparable=is_comparable, likelihoods=likelihoods)
    unknown = [None] * len(fits)
    excess = next((row.values for row in rows if row.measure == EVIDENCE), unknown)
    values = [math.inf if value is None else value for value in excess]
    order = sorted(range(len(fits)), key=values.__getitem__)
    first = {names[k]: k for k in reversed(order)}
    best = {name: fits[first[name]] for name in dict.fromkeys(names)}
    return best, {name: values[first[name]] for name in best if values[first[name]] < math.inf}


def _errors(
    best: Mapping[str, Fit], records: Sequence[Record], lengths: tuple[float | None, float | None]
) -> dict[str, float]:
    """Return the errors of predictions by structure: the mean of all outputs, in percent."""
    fits, data = [*best.values()], [records] * len(best)
    windows = window_lengths(fits, records, *lengths)
    predictions, _ = predict_same_windows(fits, [*best], data, windows, fitted=False)
    rows = prediction_rows(HELD_OUT, predictions, fits)
    shares = np.array([row.values for row in rows if row.measure == "fit"], dtype=float)
    return dict(zip(best, (100 - shares.mean(axis=0)).tolist(), strict=True))


def _best(table: Table) -> Counter[str]:
    """Return in how many data sets each structure is the best of several."""
    contests = [values for values in table.values() if len(values) > 1]
    return Counter(min(values, key=values.__getitem__) for values in contests)


def _wins(measure: str, table: Table) -> str:
    wins = _best(table)
    texts = (f"{name} in {n} ({percent(n / wins.total())} %)" for name, n in wins.most_common())
    return f"Best by {measure}, of {counted(wins.total(), 'data set')}: {', '.join(texts)}."


def _verdict(evidence: Table, sizes: Mapping[str, int]) -> tuple[str, str]:
    """Return the structure that its data sets together support, and why."""
    wins = _best(evidence).most_common(1)
    if not wins:
        return "", ""
    # Not all structures suit all data sets: judged are those of the one that is best most often.
    shared = [values for values in evidence.values() if wins[0][0] in values]
    labels = [label for label in sizes if all(label in values for values in shared)]
    # Data sets are independent, so that their log-likelihoods, and with them BIC, add up.
    totals = [sum(values[label] for values in shared) for label in labels]
    k, text = parsimony(labels, totals, [sizes[label] for label in labels])
    return labels[k], f"{counted(len(shared), 'data set')} together: {text}"
