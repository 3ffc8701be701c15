"""Fits side by side: on their own data and on records that none of them has seen."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.answer import Fit, FittedRecord, FittedResponse
from greybox.case import Case, case
from greybox.comparison import HELD_OUT, IDENTIFICATION, Comparison, NestedTest, Row
from greybox.criterion import MaximumLikelihood
from greybox.prediction import AHEAD, Prediction
from greybox.record import Record
from greybox.simulate import predict_windows
from greybox.table import number
from greybox.validation import fit_percent, input_correlation, rms, theil, variance_accounted_for, whiteness
from greybox.verdict import verdicts
from greybox.windows import cut, require_lengths

Array = NDArray[np.float64]
Predictions = tuple[tuple[Prediction, ...], ...]


def compare(
    *fits: Fit,
    records: Record | Sequence[Record] | None = None,
    window: float = 1.0,
    lead: float = 0.5,
    labels: Sequence[str] = (),
) -> Comparison:
    """Compare fits of different structures: which describes its data best, and which predicts others best.

    Cost, number of parameters, AIC and BIC are told where the fits have the same data and their costs are likelihoods.
    In time, models are judged by predictions over windows, the same ones for all, see `predict`: on the data of the
    fits, and on `records`. Whiteness and correlation with the inputs are those of predictions one sample ahead.

    Parameters
    ----------
    *fits : Fit
    records : Record or sequence of them, optional
        Held out from all fits. Without them the fits must have the same data.
    window, lead : float, s
        What is predicted, and what is measured before it to tell the state.
    labels : sequence of str, optional
        One for each fit; by default the names of the models.

    Raises
    ------
    TypeError, ValueError
        For what is no fit, a fit without an answer, data that differ and no records, or records that do not fit.

    Sources: Klein and Morelli, Aircraft System Identification, 2nd ed., chapters 5, 6 and 11; Ljung (1999), System
    Identification, 2nd ed., sections 16.4 to 16.6; Jategaonkar (2006), Flight Vehicle System Identification, chapter
    11; Burnham and Anderson (2002), Model Selection and Multimodel Inference.
    """
    _check(fits, labels)
    require_lengths(window=window, lead=lead)
    names = tuple(labels) or _labels(fits)
    held_out = _records(records)
    different = _difference(fits, names)
    if different and not held_out:
        raise ValueError(f"{different}: fit them to the same data, or give records=[...] on which to judge them.")
    rows = _whole(fits, same=not different)
    found: dict[str, Predictions] = {}
    if not different and fits[0].records:
        data = [[part.data for part in fit.records] for fit in fits]
        found[IDENTIFICATION] = _predicted(fits, data, window, lead, own=True)
    if held_out:
        found[HELD_OUT] = _predicted(fits, [held_out] * len(fits), window, lead, own=False)
    for place, predictions in found.items():
        rows += _measured(place, predictions, fits)
    seen = _seen(fits, names, held_out)
    return Comparison(
        labels=names,
        data=f"{different}: their costs are not compared" if different else _data(fits),
        rows=tuple(rows),
        statements=(*seen, *verdicts(fits, names, found, same=not different)),
        window=window if found else None,
        lead=lead if found else None,
        windows={place: sum(len(p) for p in predictions[0]) for place, predictions in found.items()},
        predictions=found,
    )


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
    different = _difference((small, large), names)
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
    if _is_likelihood(small) and _is_likelihood(large) and large.white is not None:
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


def _labels(fits: Sequence[Fit]) -> tuple[str, ...]:
    """Return the names of the models, with those of the problems or numbers where they do not tell the fits apart."""
    models = [", ".join(dict.fromkeys(part.label for part in fit.parts)) for fit in fits]
    for said in (models, [f"{m} ({fit.name})" for m, fit in zip(models, fits, strict=True)]):
        if len(set(said)) == len(said):
            return tuple(said)
    return tuple(f"{model} {k}" for k, model in enumerate(models, 1))


def _nested_labels(small: Fit, large: Fit) -> tuple[str, str]:
    """Return the names of the models; that of one model with fewer parameters free says which."""
    names = _labels((small, large))
    models = [fit.parts[0].label for fit in (small, large)]
    held = [name for name in large.free if name not in small.free and name in small.estimate]
    if models[0] != models[1] or not held:
        return names[0], names[1]
    return f"{models[0]} with {', '.join(held)} fixed", models[1]


def _difference(fits: Sequence[Fit], names: Sequence[str]) -> str:
    """Return in words how the data of a fit differ from those of the first, or nothing."""
    first = fits[0]
    for fit, name in zip(fits[1:], names[1:], strict=True):
        if len(fit.parts) != len(first.parts):
            return f"{name} was fitted to {len(fit.parts)} sets of data and {names[0]} to {len(first.parts)}"
        for a, b in zip(first.parts, fit.parts, strict=True):
            if not _same(a, b):
                return (
                    f"{name} was fitted to other data than {names[0]} ({b.data.name or b.name!r}, checksum "
                    f"{b.data.checksum[:8]}, and {a.data.name or a.name!r}, {a.data.checksum[:8]})"
                )
            if isinstance(a, FittedRecord) and isinstance(b, FittedRecord) and a.outputs != b.outputs:
                return (
                    f"{name} was fitted to the outputs {', '.join(b.outputs)} and {names[0]} to {', '.join(a.outputs)}"
                )
            if _count(a) != _count(b):
                return (
                    f"{name} was fitted to {_count(b)} numbers of the record and {names[0]} to {_count(a)}, since the "
                    "longest delay in the bounds keeps the first samples out (give both the same bounds)"
                )
    return ""


def _same(a: FittedResponse | FittedRecord, b: FittedResponse | FittedRecord) -> bool:
    """Tell whether two parts have the same data: a stretch of a log has the checksum of the whole log."""
    if a.data.checksum != b.data.checksum:
        return False
    if isinstance(a.data, Record) and isinstance(b.data, Record):
        return np.array_equal(a.data.time, b.data.time) and all(
            np.array_equal(a.data[n], b.data[n], equal_nan=True) for n in a.data.signals if n in b.data.signals
        )
    return type(a) is type(b)


def _data(fits: Sequence[Fit]) -> str:
    parts = [f"{part.data.name or part.name} ({part.data.checksum[:8]})" for part in fits[0].parts]
    count = sum(_count(part) for part in fits[0].parts)
    return f"the same for all: {', '.join(parts)}, {count} numbers"


def _count(part: FittedResponse | FittedRecord) -> int:
    if isinstance(part, FittedResponse):
        return 2 * len(part.data)
    return sum(int(np.isfinite(part.residual(name)).sum()) for name in part.outputs)


def _is_likelihood(fit: Fit) -> bool:
    """Tell whether the cost is the negative logarithm of a likelihood."""
    return all(
        part.weight == 1 and (isinstance(part, FittedRecord) or part.rule == MaximumLikelihood().description)
        for part in fit.parts
    )


def _whole(fits: Sequence[Fit], same: bool) -> list[Row]:
    """Return what belongs to the fits as a whole."""
    likelihood = same and all(_is_likelihood(fit) for fit in fits)
    rules = list(dict.fromkeys(fit.criterion for fit in fits))
    comparable = same and len(rules) == 1
    unknowns = [len(fit.free) + sum(part.nuisances for part in fit.records) for fit in fits]
    numbers = [sum(_count(part) for part in fit.parts) for fit in fits]
    costs = [fit.cost for fit in fits]
    rows = [
        _row("fit", "", f"cost: {rules[0]}" if comparable else "cost", "", costs if comparable else None, fits),
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
    others = dict.fromkeys(rule for fit in fits for rule in fit.costs if same)
    for rule in others:
        if not (comparable and rule == rules[0]):
            rows.append(_row("fit", "", f"cost: {rule}", "", [f.costs.get(rule, math.nan) for f in fits], fits))
    return [row for row in rows if any(v is not None for v in row.values) or row.measure in ("cost", "AIC", "BIC")]


def _row(data: str, output: str, measure: str, unit: str, values: Sequence[float] | None, fits: Sequence[Any]) -> Row:
    known = [None] * len(fits) if values is None else [float(v) if math.isfinite(v) else None for v in values]
    return Row(data, output, measure, unit, tuple(known))


def _predicted(
    fits: Sequence[Fit], data: Sequence[Sequence[Record]], window: float, lead: float, own: bool
) -> Predictions:
    """Return for every fit the predictions of every record, over windows that all fits can use."""
    columns = []
    for k in range(len(data[0])):
        cases = [_case(fit, k if own else None) for fit in fits]
        record = _joined([records[k] for records in data])
        inputs = dict.fromkeys(name for at in cases for name in at.system.inputs)
        common = [name for name in cases[0].system.outputs if all(name in at.system.outputs for at in cases)]
        outputs = tuple(name for name in common if name in record.signals)
        if not outputs:
            raise ValueError(
                f"{record.name or 'the record'} has no output that all fits have ({', '.join(common) or 'none'}); "
                f"it has {', '.join(record.signals)}."
            )
        windows = cut(record, tuple(inputs), outputs, lead=lead, horizon=window, called="window")
        columns.append([predict_windows(at, windows, outputs, lead, window, called="window") for at in cases])
    return tuple(zip(*columns, strict=True))


def _case(fit: Fit, record: int | None) -> Case:
    """Return a fit as it is simulated, for its own k-th record or for one that it has not seen."""
    if record is None:
        return case(fit)
    return case(fit, part=[k for k, part in enumerate(fit.parts) if isinstance(part, FittedRecord)][record])


def _joined(records: Sequence[Record]) -> Record:
    """Return one record with the signals of all, which are of the same data."""
    first = records[0]
    more = {name: r[name] for r in records[1:] for name in r.signals if name not in first.signals}
    if not more:
        return first
    units = {name: r.units.get(name, "") for r in records for name in r.signals}
    return Record(first.time, {**first.signals, **more}, units, first.name, first.source, first.checksum)


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
        for ahead in AHEAD:
            grown = [_grown(ps, output, ahead) for ps in of]
            add(f"  {number(ahead * of[0][0].horizon, 3)} s ahead", unit, grown)
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
    place = [max(1, math.ceil(share * p.rows.shape[1] - 1e-9)) - 1 for p in predictions]
    return rms(np.concatenate([p.residual(output)[:, k] for p, k in zip(predictions, place, strict=True)]))


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
