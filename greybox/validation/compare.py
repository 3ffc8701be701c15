"""Fits side by side: on their own data and on records that none of them has seen."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.data.record import Record
from greybox.estimate.result import Fit
from greybox.simulation.prediction import Prediction, reported_shares, samples_ahead
from greybox.simulation.windows import require_lengths, seconds
from greybox.statistics.metrics import fit_percent, input_correlation, rms, theil, variance_accounted_for, whiteness
from greybox.validation.comparison import HELD_OUT, IDENTIFICATION, Comparison, NestedTest, Row
from greybox.validation.same_data import (
    LIKELIHOOD,
    count_numbers,
    data_difference,
    described,
    is_likelihood,
    labels_of,
    other_samples,
    why_not_comparable,
)
from greybox.validation.same_windows import Predictions, lengths_of, predicted
from greybox.validation.significance import verdicts

Array = NDArray[np.float64]


def compare(
    *fits: Fit,
    records: Record | Sequence[Record] | None = None,
    window: float | None = None,
    lead: float | None = None,
    labels: Sequence[str] = (),
) -> Comparison:
    """Compare fits of different structures: which describes its data best, and which predicts others best.

    Cost, number of parameters, AIC and BIC are told where the fits have the same data and their costs are likelihoods,
    as all in time are; else a sentence says why not. In time, models are judged by predictions over windows, the same
    ones for all, see `predict`: on the data of the fits, and on `records`. Windows in which one of the models has no
    finite value are left out for all and counted. Whiteness and correlation with the inputs are those of predictions
    one sample ahead.

    Two models predict alike where their mean squared errors differ by less than 0.1 % of the smaller one, or by less
    than a millionth of the spread of an output (what simulations are accurate to): only beyond that does a test decide.
    They describe their data alike where AIC differs by less than 2 (Burnham and Anderson, section 2.6).

    Parameters
    ----------
    *fits : Fit
    records : Record or sequence of them, optional
        Held out from all fits. Without them the fits must have the same data.
    window, lead : float, s
        What is predicted, and what is measured before it to tell the state, rounded to whole samples. By default 1 s
        and 0.5 s, or 10 samples of the slowest record where that is longer, for the lead-in also at least twice the
        longest delay.
    labels : sequence of str, optional
        One for each fit; by default the names of the models.

    Raises
    ------
    TypeError, ValueError
        For what is no fit, a fit without an answer, data that differ and no records, records that do not fit, lengths
        shorter than a sample, or a model without finite values in half of the windows.

    Sources: Klein and Morelli, Aircraft System Identification, 2nd ed., chapters 5, 6 and 11; Ljung (1999), System
    Identification, 2nd ed., sections 16.4 to 16.6; Jategaonkar (2006), Flight Vehicle System Identification, chapter
    11; Burnham and Anderson (2002), Model Selection and Multimodel Inference.
    """
    _check(fits, labels)
    require_lengths(**{name: v for name, v in (("window", window), ("lead", lead)) if v is not None})
    names = tuple(labels) or labels_of(fits)
    held_out = _records(records)
    different = data_difference(fits, names)
    if different and not held_out:
        raise ValueError(f"{different}: fit them to the same data, or give records=[...] on which to judge them.")
    apart = different or why_not_comparable(fits, names)
    rows = _whole(fits, same=not different, comparable=not apart)
    data: dict[str, list[list[Record]]] = {}  # of every fit
    if not different and fits[0].records:
        data[IDENTIFICATION] = [[part.data for part in fit.records] for fit in fits]
    if held_out:
        data[HELD_OUT] = [held_out] * len(fits)
    lengths = lengths_of(fits, [record for given in data.values() for record in given[0]], window, lead)
    found: dict[str, Predictions] = {}
    said = [_uncompared(apart, fits)] if apart and not different else []
    said += _seen(fits, names, held_out)
    for place, given in data.items():
        found[place], left = predicted(fits, names, given, lengths, own=place == IDENTIFICATION)
        said += left
    for place, predictions in found.items():
        rows += _measured(place, predictions, fits)
    first = next(iter(found.values()))[0][0] if found else None
    return Comparison(
        labels=names,
        data=f"{different}: their costs are not compared" if different else described(fits),
        rows=tuple(rows),
        statements=(*said, *verdicts(fits, names, found, same=not different, comparable=not apart)),
        window=first.horizon if first else None,
        lead=first.lead if first else None,
        windows={place: sum(len(p) for p in predictions[0]) for place, predictions in found.items()},
        predictions=found,
    )


def _uncompared(apart: str, fits: Sequence[Fit]) -> str:
    more = "; the table has each criterion for all of them" if any(fit.costs for fit in fits) else ""
    return f"Costs, AIC and BIC are not compared: {apart}{more}."


def nested_test(small: Fit, large: Fit) -> NestedTest:
    """Test whether the parameters that `large` has free and `small` has not are needed.

    The ratio of likelihoods is divided by how much larger the variance of these parameters is than white residuals
    would make it, so that it keeps its size where residuals are correlated in time (the mean of the scaled statistic
    is that of chi-square, over its degrees of freedom F). Where the cost is no likelihood, the estimates of these
    parameters are compared with their values in `small` by their covariance (Wald).

    Raises
    ------
    ValueError
        If the data differ, the free parameters of `small` are not among those of `large`, or `large` costs more.

    Sources: Rotnitzky and Jewell (1990), Biometrika 77; Satorra and Bentler (1994); Klein and Morelli, chapter 5.
    """
    _check((small, large), ())
    names = _nested_labels(small, large)
    different = data_difference((small, large), names) or other_samples((small, large), names)
    if different:
        raise ValueError(f"{different}: a nested test needs fits of the same data.")
    extra = tuple(name for name in large.free if name not in small.free)
    if not extra or not set(small.free) < set(large.free):
        raise ValueError(
            f"{names[0]} (free: {', '.join(small.free)}) is not {names[1]} (free: {', '.join(large.free)}) with terms "
            "removed: fix or leave out parameters of the larger, and compare others with gb.compare."
        )
    covariance = large.covariance_of(extra)
    if not np.all(np.isfinite(covariance)):
        raise ValueError(f"the data do not determine {', '.join(extra)} of {names[1]}: nothing can be tested.")
    r, scale, ratio = len(extra), 1.0, math.nan
    if is_likelihood(small) and is_likelihood(large) and large.white is not None:
        ratio = 2 * (small.cost - large.cost)
        if ratio < -1e-3 * max(1.0, abs(large.cost) * 1e-6):
            raise ValueError(
                f"{names[1]} costs more than {names[0]}, which it contains: its fit has not found the minimum; "
                "give it more starts."
            )
        places = [large.free.index(name) for name in extra]
        white = large.white[np.ix_(places, places)]
        scale = float(np.trace(np.linalg.solve(white, covariance))) / r
        statistic = max(ratio, 0.0) / (scale * r)
    else:
        away = np.array([large.estimate[n] - small.estimate.get(n, 0.0) for n in extra])
        statistic = float(away @ np.linalg.solve(covariance, away)) / r
    return NestedTest(*names, extra, ratio, scale, statistic, (r, large.dof), _p_value(statistic, r, large.dof))


def _p_value(statistic: float, r: int, dof: float) -> float:
    from scipy.special import chdtrc, fdtrc  # noqa: PLC0415  (takes a tenth of a second to import)

    return float(chdtrc(r, r * statistic) if math.isinf(dof) else fdtrc(r, dof, statistic))


def _check(fits: Sequence[Fit], labels: Sequence[str]) -> None:
    wrong = [fit for fit in fits if not isinstance(fit, Fit)]
    if wrong:
        raise TypeError(f"cannot compare {wrong[0]!r:.80}: give fits, such as gb.fit(problem) returns.")
    if len(fits) < 2:
        raise ValueError(f"there is {len(fits) or 'no'} fit to compare: give at least two.")
    texts = isinstance(labels, Sequence) and not isinstance(labels, str) and all(isinstance(n, str) for n in labels)
    if not texts or (labels and len(set(labels)) != len(fits)):
        raise ValueError(f"labels is {labels!r:.80}: give a list of {len(fits)} different texts, one for each fit.")
    for fit in fits:
        if not fit.converged:
            raise ValueError(f"the fit {fit.name!r} has no estimate: {fit.status}.")


def _records(given: Any) -> list[Record]:
    """Return the held-out records that a user gives."""
    found = [given] if isinstance(given, Record) else [] if given is None else given
    if not isinstance(found, Sequence) or not all(isinstance(item, Record) for item in found):
        raise TypeError(f"records is {given!r:.80}: give a Record or a list of them.")
    return list(found)


def _nested_labels(small: Fit, large: Fit) -> tuple[str, str]:
    """Return the names of the models; that of one model with fewer parameters free says which."""
    names = labels_of((small, large))
    models = [fit.parts[0].label for fit in (small, large)]
    held = [name for name in large.free if name not in small.free and name in small.estimate]
    if models[0] != models[1] or not held:
        return names[0], names[1]
    return f"{models[0]} with {', '.join(held)} fixed", models[1]


def _whole(fits: Sequence[Fit], same: bool, comparable: bool) -> list[Row]:
    """Return what belongs to the fits as a whole."""
    likelihood = comparable and all(is_likelihood(fit) for fit in fits)
    rules = list(dict.fromkeys(fit.criterion for fit in fits))
    rule = rules[0] if len(rules) == 1 else LIKELIHOOD
    unknowns = [len(fit.free) + sum(part.nuisances for part in fit.records) for fit in fits]
    numbers = [sum(count_numbers(part) for part in fit.parts) for fit in fits]
    costs = [fit.cost for fit in fits]
    rows = [
        _row("fit", "", f"cost: {rule}" if comparable else "cost", "", costs if comparable else None, fits),
        _row("fit", "", "free parameters", "", [len(fit.free) for fit in fits], fits),
        _row("fit", "", "numbers in the data", "", numbers, fits),
        _row("fit", "", "degrees of freedom", "", [fit.dof for fit in fits], fits),
    ]
    aic = [2 * k + 2 * c for k, c in zip(unknowns, costs, strict=True)]
    bic = [k * math.log(n) + 2 * c for k, c, n in zip(unknowns, costs, numbers, strict=True)]
    for name, values in (("AIC", aic), ("BIC", bic)):
        rows.append(_row("fit", "", name, "", values if likelihood else None, fits))
        least = [value - min(values) for value in values]
        rows.append(_row("fit", "", f"{name} less the least", "", least if likelihood else None, fits))
    for other in dict.fromkeys(name for fit in fits for name in fit.costs if same):
        if not (comparable and other == rule):
            rows.append(_row("fit", "", f"cost: {other}", "", [f.costs.get(other, math.nan) for f in fits], fits))
    return [row for row in rows if any(v is not None for v in row.values) or row.measure in ("cost", "AIC", "BIC")]


def _row(data: str, output: str, measure: str, unit: str, values: Sequence[float] | None, fits: Sequence[Any]) -> Row:
    known = [None] * len(fits) if values is None else [float(v) if math.isfinite(v) else None for v in values]
    return Row(data, output, measure, unit, tuple(known))


def _measured(place: str, predictions: Predictions, fits: Sequence[Fit]) -> list[Row]:
    """Return the measures of every output over all windows of all records."""
    rows: list[Row] = []
    outputs = dict.fromkeys(name for p in predictions[0] for name in p.outputs)
    for output in outputs:
        unit = next((p.data.units.get(output, "") for p in predictions[0] if output in p.outputs), "")
        of = [[p for p in ps if output in p.outputs] for ps in predictions]
        measured = [np.concatenate([p.measured(output).ravel() for p in ps]) for ps in of]
        predicted = [np.concatenate([p.predicted[p.outputs.index(output)].ravel() for p in ps]) for ps in of]
        pairs = list(zip(measured, predicted, strict=True))
        coefficients = [theil(y, p) for y, p in pairs]

        def add(measure: str, unit: str, values: Sequence[float], output: str = output) -> None:
            rows.append(_row(place, output, measure, unit, values, fits))

        add("fit", "%", [fit_percent(y, p) for y, p in pairs])
        add("variance accounted for", "%", [variance_accounted_for(y, p) for y, p in pairs])
        add("Theil's coefficient", "", [t.coefficient for t in coefficients])
        for share in ("bias", "variance", "covariance"):
            add(f"  its share of {share}", "", [getattr(t, share) for t in coefficients])
        add("error (rms)", unit, [rms(y - p) for y, p in pairs])
        for share in reported_shares([p.rows.shape[1] for p in of[0]]):
            add(f"  {_how_far(of[0], share)} s ahead", unit, [_grown(ps, output, share) for ps in of])
        tests = [whiteness(_one_step(ps, output), fitted=_gains(fit, output)) for ps, fit in zip(of, fits, strict=True)]
        add("one step ahead: error over noise", "", [rms(np.concatenate(_one_step(ps, output))) for ps in of])
        add("  white (p)", "", [t.p_value for t in tests])
        for name in dict.fromkeys(n for fit in fits for part in fit.records for n in part.data.signals):
            if name not in outputs and all(name in p.data.signals for ps in of for p in ps):
                tests = [input_correlation(_one_step(ps, output), _inputs(ps, name)) for ps in of]
                add(f"  not correlated with {name} (p)", "", [t.p_value for t in tests])
                add(f"  lags of {name} beyond 99 %", "of 25", [t.outside for t in tests])
    return rows


def _grown(predictions: Sequence[Prediction], output: str, share: float) -> float:
    """Return the root mean square error at a share of the horizon."""
    place = [samples_ahead(share, p.rows.shape[1]) - 1 for p in predictions]
    return rms(np.concatenate([p.residual(output)[:, k] for p, k in zip(predictions, place, strict=True)]))


def _how_far(predictions: Sequence[Prediction], share: float) -> str:
    """Say how far ahead a share of the horizon is, in s, in records that may have different sample times."""
    ahead = [float(p.ahead[samples_ahead(share, p.rows.shape[1]) - 1]) for p in predictions]
    return " to ".join(dict.fromkeys((seconds(min(ahead)), seconds(max(ahead)))))


def _one_step(predictions: Sequence[Prediction], output: str) -> list[Array]:
    """Return the errors one step ahead, in the order of time, cut where the record is."""
    return _stretches(predictions, lambda p: p.one_step[p.outputs.index(output)])


def _inputs(predictions: Sequence[Prediction], name: str) -> list[Array]:
    return [s for p in predictions for s in _cut(p.data, p.data[name])]


def _stretches(predictions: Sequence[Prediction], values: Callable[[Prediction], Array]) -> list[Array]:
    result = []
    for p in predictions:
        along = np.full(len(p.data), np.nan)
        along[p.rows.ravel()] = values(p).ravel()
        result += _cut(p.data, along)
    return result


def _cut(record: Record, values: Array) -> list[Array]:
    """Cut values (n,) where the record has gaps."""
    return np.split(values, np.cumsum([len(piece) for piece in record.pieces])[:-1])


def _gains(fit: Fit, output: str) -> int:
    return max((sum(o == output for _, o in part.gains) for part in fit.records), default=0)


def _seen(fits: Sequence[Fit], names: Sequence[str], records: Sequence[Record]) -> list[str]:
    """Say which of the held-out records a fit was made with after all."""
    return [
        f"warning: {record.name or 'a record'} is not held out: {name} was fitted to samples of it."
        for record in records
        for fit, name in zip(fits, names, strict=True)
        if any(_overlap(part.data, record) for part in fit.records)
    ]


def _overlap(a: Record, b: Record) -> bool:
    return a.checksum == b.checksum and a.time[0] <= b.time[-1] and b.time[0] <= a.time[-1]
