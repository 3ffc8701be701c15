"""The rows of a comparison's table: information criteria of the fits, and measures of their predictions."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.data.record import Record
from greybox.estimate.result import Fit
from greybox.files.arrays import Array
from greybox.simulation.prediction import Prediction, reported_shares, samples_ahead
from greybox.simulation.windows import seconds
from greybox.statistics.metrics import (
    LAGS,
    fit_percent,
    input_correlation,
    rms,
    theil,
    variance_accounted_for,
    whiteness,
)
from greybox.validation.common_likelihood import Likelihoods
from greybox.validation.comparison import Row
from greybox.validation.held_out import Predictions
from greybox.validation.same_data import LIKELIHOOD, count_numbers, count_unknowns, is_likelihood


def fit_rows(
    fits: Sequence[Fit],
    *,
    same_data: bool,
    comparable: bool,
    likelihoods: Likelihoods | None = None,
) -> list[Row]:
    """Return what belongs to the fits as a whole: costs, sizes, AIC, AICc and BIC.

    Costs are given where they are `comparable`, and the criteria of information where they are
    likelihoods too or the fits have been given common `likelihoods`.
    """
    names = list(dict.fromkeys(fit.criterion for fit in fits))
    criterion = names[0] if len(names) == 1 else LIKELIHOOD
    numbers = [sum(count_numbers(part) for part in fit.parts) for fit in fits]

    rows = [
        _row(f"cost: {criterion}", [fit.cost for fit in fits])
        if comparable
        else _unknown_row("cost", fits),
        _row("free parameters", [len(fit.free) for fit in fits]),
        _row("numbers in the data", numbers),
        _row("degrees of freedom", [fit.dof for fit in fits]),
    ]
    if likelihoods is not None:
        unknowns = [len(fit.free) + k for fit, k in zip(fits, likelihoods.nuisances, strict=True)]
        rows += [_row("negative log-likelihood", likelihoods.costs)]
        rows += _information_rows(likelihoods.costs, unknowns, numbers)
    elif comparable and all(is_likelihood(fit) for fit in fits):
        rows += _information_rows(
            [fit.cost for fit in fits], [count_unknowns(fit) for fit in fits], numbers
        )
    else:
        rows += [_unknown_row("AIC", fits), _unknown_row("BIC", fits)]
    if same_data:
        rows += _other_costs(fits, criterion if comparable else "")
        if all(fit.responses for fit in fits):
            rows += [
                replace(
                    _row("relative residual (rms)", [_relative_rms(fit) for fit in fits]), unit="%"
                )
            ]
    # That costs, AIC and BIC do not exist is worth a row; of other measures it is not.
    return [
        row
        for row in rows
        if row.measure in ("cost", "AIC", "BIC") or any(v is not None for v in row.values)
    ]


def _information_rows(
    costs: Sequence[float], unknowns: Sequence[int], numbers: Sequence[int]
) -> Iterator[Row]:
    """Yield AIC = 2 k - 2 ln L, AICc and BIC = k ln n - 2 ln L, for k unknowns and n numbers, and their differences.

    AICc adds 2 k (k + 1) / (n - k - 1); there is none where n is not larger than k + 1. Source:
    Burnham and Anderson (2002), section 2.4.
    """
    sizes = list(zip(unknowns, numbers, strict=True))
    penalties = {
        "AIC": [2.0 * k for k, _ in sizes],
        "AICc": [2.0 * k * n / (n - k - 1) if n > k + 1 else math.nan for k, n in sizes],
        "BIC": [k * math.log(n) for k, n in sizes],
    }
    for name, penalty in penalties.items():
        values = [term + 2 * cost for term, cost in zip(penalty, costs, strict=True)]
        yield _row(name, values)
        yield _row(
            f"{name} less the least", [value - np.nanmin([*values, math.inf]) for value in values]
        )


def _other_costs(fits: Sequence[Fit], minimized: str) -> Iterator[Row]:
    """Yield the included criteria at the estimates, without the one whose costs are compared already."""
    for name in dict.fromkeys(name for fit in fits for name in fit.costs):
        if name != minimized:
            yield _row(f"cost: {name}", [fit.costs.get(name, math.nan) for fit in fits])


def _relative_rms(fit: Fit) -> float:
    """Return the size of the relative residuals of all responses, in percent."""
    with np.errstate(divide="ignore", invalid="ignore"):  # zeros among the data have none
        shares = [np.abs(part.response / part.data.response - 1) for part in fit.responses]
    return 100 * rms(np.concatenate(shares))


def _row(measure: str, values: Sequence[float]) -> Row:
    return Row("fit", "", measure, "", _finite(values))


def _unknown_row(measure: str, fits: Sequence[Fit]) -> Row:
    return _row(measure, [math.nan] * len(fits))


def _finite(values: Sequence[float]) -> tuple[float | None, ...]:
    return tuple(float(value) if math.isfinite(value) else None for value in values)


def prediction_rows(kind: str, predictions: Predictions, fits: Sequence[Fit]) -> list[Row]:
    """Return the measures of every output over all windows of all records of a `kind` of data."""
    estimated = [sum(len(p.own) for p in of_fit) for of_fit in predictions]
    rows = (
        [Row(kind, "", "values estimated from the records", "", _finite(estimated))]
        if any(estimated)
        else []
    )
    outputs = list(
        dict.fromkeys(name for prediction in predictions[0] for name in prediction.outputs)
    )
    for name in outputs:
        holding = tuple(tuple(p for p in of_fit if name in p.outputs) for of_fit in predictions)
        output = _Output(kind, name, holding)
        rows += _accuracy_rows(output)
        rows += _growth_rows(output)
        rows += _one_step_rows(output, fits)
        rows += _input_rows(output, fits, outputs)
    return rows


@dataclass(frozen=True, eq=False)
class _Output:
    """One output of the records that hold it, as predicted by every fit."""

    kind: str
    name: str
    predictions: Predictions

    @property
    def unit(self) -> str:
        return self.predictions[0][0].data.units.get(self.name, "")

    @property
    def in_time(self) -> bool:
        """Whether one of its records has a time."""
        return any(p.data.has_time for p in self.predictions[0])

    def row(
        self,
        measure: str,
        unit: str,
        values: Sequence[float],
        signal: str = "",
        *,
        is_detail: bool = False,
    ) -> Row:
        return Row(self.kind, self.name, measure, unit, _finite(values), signal, is_detail)

    def one_step(self) -> list[list[Array]]:
        """Return the errors one step ahead of every fit, in the order of time, cut where the records are."""
        return [
            [
                piece
                for p in of_fit
                for piece in _in_time_order(p, p.one_step[p.outputs.index(self.name)])
            ]
            for of_fit in self.predictions
        ]


def _accuracy_rows(output: _Output) -> Iterator[Row]:
    """Yield the measures over all predicted samples."""
    pairs = []
    for of_fit in output.predictions:
        measured = np.concatenate([p.measured(output.name).ravel() for p in of_fit])
        predicted = np.concatenate(
            [p.predicted[p.outputs.index(output.name)].ravel() for p in of_fit]
        )
        pairs.append((measured, predicted))
    coefficients = [theil(measured, predicted) for measured, predicted in pairs]

    yield output.row(
        "fit", "%", [fit_percent(measured, predicted) for measured, predicted in pairs]
    )
    yield output.row(
        "variance accounted for",
        "%",
        [variance_accounted_for(m, p) for m, p in pairs],
        is_detail=True,
    )
    yield output.row(
        "Theil's coefficient", "", [t.coefficient for t in coefficients], is_detail=True
    )
    for share in ("bias", "variance", "covariance"):
        yield output.row(
            f"  its share of {share}", "", [getattr(t, share) for t in coefficients], is_detail=True
        )
    yield output.row(
        "error (rms)", output.unit, [rms(measured - predicted) for measured, predicted in pairs]
    )


def _growth_rows(output: _Output) -> Iterator[Row]:
    """Yield how the error grows over the horizon; rows have none."""
    first = output.predictions[0]
    if not output.in_time:
        return
    for share in reported_shares([_horizon(p) for p in first]):
        errors = []
        for of_fit in output.predictions:
            ahead = [
                p.residual(output.name)[:, samples_ahead(share, _horizon(p)) - 1] for p in of_fit
            ]
            errors.append(rms(np.concatenate(ahead)))
        yield output.row(
            f"  {_seconds_ahead(first, share)} s ahead", output.unit, errors, is_detail=True
        )


def _one_step_rows(output: _Output, fits: Sequence[Fit]) -> Iterator[Row]:
    """Yield the size of the errors one step ahead, in units of their standard deviations, and their whiteness."""
    errors = output.one_step()
    if not output.in_time:
        yield output.row("error over noise", "", [rms(np.concatenate(of_fit)) for of_fit in errors])
        return
    tests = [
        whiteness(of_fit, fitted=_gains(fit, output.name))
        for of_fit, fit in zip(errors, fits, strict=True)
    ]
    yield output.row(
        "one step ahead: error over noise", "", [rms(np.concatenate(of_fit)) for of_fit in errors]
    )
    yield output.row("  white (p)", "", [test.p_value for test in tests])


def _input_rows(output: _Output, fits: Sequence[Fit], outputs: Sequence[str]) -> Iterator[Row]:
    """Yield the correlation of the errors one step ahead with every signal that is no output and not constant."""
    if not output.in_time:
        return
    errors = output.one_step()
    for name in dict.fromkeys(
        name for fit in fits for part in fit.records for name in part.data.signals
    ):
        if name in outputs or not all(
            name in p.data.signals for of_fit in output.predictions for p in of_fit
        ):
            continue
        signals = [
            [s for p in of_fit for s in _pieces(p.data, p.data[name])]
            for of_fit in output.predictions
        ]
        if all(_is_constant(of_fit) for of_fit in signals):
            continue
        tests = [input_correlation(e, u) for e, u in zip(errors, signals, strict=True)]
        yield output.row(
            f"  not correlated with {name} (p)", "", [test.p_value for test in tests], name
        )
        lags = [test.outside for test in tests]
        yield output.row(f"  lags of {name} beyond 99 %", f"of {LAGS}", lags, name, is_detail=True)


def _is_constant(pieces: Sequence[Array]) -> bool:
    """Tell whether a signal has one value in all pieces."""
    values = np.concatenate(pieces)
    values = values[np.isfinite(values)]
    return not values.size or float(np.ptp(values)) == 0


def _horizon(prediction: Prediction) -> int:
    """Return the length of the windows in samples."""
    return prediction.rows.shape[1]


def _seconds_ahead(predictions: Sequence[Prediction], share: float) -> str:
    """Say how far ahead a share of the horizon is, in s, in records that may have different sample times."""
    ahead = [float(p.ahead[samples_ahead(share, _horizon(p)) - 1]) for p in predictions]
    return " to ".join(dict.fromkeys((seconds(min(ahead)), seconds(max(ahead)))))


def _in_time_order(prediction: Prediction, values: Array) -> list[Array]:
    """Return values (w, h) of the windows along the record, NaN between them, cut where the record has gaps."""
    along = np.full(len(prediction.data), np.nan)
    along[prediction.rows.ravel()] = values.ravel()
    return _pieces(prediction.data, along)


def _pieces(record: Record, values: Array) -> list[Array]:
    """Cut values (n,) where the record has gaps."""
    return [values[rows] for rows in record.independent_pieces]


def _gains(fit: Fit, output: str) -> int:
    """Return how many parameters of the noise were fitted to the residuals of this output, for the whiteness test."""
    return max((part.innovation_parameters(output) for part in fit.records), default=0)
