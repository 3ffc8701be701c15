"""Fits side by side: on their own data and on records that none of them has seen."""

from collections.abc import Mapping, Sequence
from typing import Any

from greybox.data.record import Record
from greybox.estimate.result import Fit
from greybox.modeling.model import require_known
from greybox.simulation.windows import require_lengths
from greybox.validation.common_likelihood import Likelihoods, common_likelihood
from greybox.validation.comparison import HELD_OUT, IDENTIFICATION, Comparison, Row
from greybox.validation.cross_validation import cross_validation
from greybox.validation.held_out import (
    Predictions,
    not_held_out,
    predict_same_windows,
    require_own,
    window_lengths,
)
from greybox.validation.measures import fit_rows, prediction_rows
from greybox.validation.parsimony import parsimony
from greybox.validation.same_data import (
    check_fits,
    data_difference,
    is_likelihood,
    labels_of,
    shared_data,
    why_not_comparable,
)
from greybox.validation.significance import Evidence, Pair, verdicts


def compare(
    *fits: Fit,
    records: Record | Sequence[Record] | None = None,
    window: float | None = None,
    lead: float | None = None,
    labels: Sequence[str] = (),
    removed_at: Mapping[str, float] | None = None,
    own: Sequence[str] | None = None,
    folds: int | str | None = None,
) -> Comparison:
    """Compare fits of different structures: which describes its data best, and which predicts others best.

    Cost, number of parameters, AIC, AICc and BIC are given where the fits have the same data and
    their costs are likelihoods, as all in time are; otherwise a sentence says why not. Fits of
    frequency responses may have different criteria: the table has each of them at every estimate,
    and AIC, AICc and BIC are of one likelihood, that of `MaximumLikelihood` where the data have
    variances and otherwise that of `RelativeLikelihood`, maximized again from every estimate. One
    sentence names the smallest structure that the data support: the one with the fewest parameters
    of those whose BIC is within 2 of the least. In time, models are judged by predictions over
    windows, the same ones for all, see `predict`: on the data of the fits, and on `records`.
    Windows in which one of the models has no finite value are left out for all and counted.
    Whiteness and correlation with the inputs are those of predictions one sample ahead.

    Where one model is another with terms removed (see `nested_test` for how that is decided), their
    fits to the same data are held against one another by the likelihood ratio, of responses by that
    of their criterion or, where these differ, of the common likelihood; other models in time by
    Vuong's test, and they describe their data equally well where AIC differs by less than 2
    (Burnham and Anderson, section 2.6). Where no test applies or decides, a sentence says that it
    cannot be told.

    Two models predict equally well where their mean squared errors differ by less than 0.1 % of the
    smaller one, or by less than a millionth of the spread of an output (the accuracy of
    simulations), or where no test finds a difference and the 95 % interval of it is within 10 %.
    What held-out records say stands beside what the data of the fits say.

    Parameters
    ----------
    *fits : Fit
    records : Record or sequence of them, optional
        Held out from all fits. Without them the fits must have the same data.
    window, lead : float, s
        What is predicted, and what is measured before it to estimate the state, rounded to whole
        samples. By default 1 s and 0.5 s, or 10 samples of the slowest record where that is longer,
        for the lead-in also at least twice the longest delay. Rows without a time are predicted one
        by one.
    labels : sequence of str, optional
        One for each fit; by default the names of the models.
    removed_at : mapping of name to value, optional
        At which parameters leave a larger model as a smaller one, where neither zero nor one does,
        see `nested_test`.
    own : sequence of str, optional
        What belongs to a record and not to a model, and is estimated from every held-out record
        before its windows are predicted: names of parameters and biases, see `predict`, whose
        default is that here. It is said and counted.

    Raises
    ------
    TypeError, ValueError
        For what is no fit, a fit without an answer, data that differ and no records, records that
        do not fit, lengths shorter than a sample, or a model without finite values in half of the
        windows.

    Sources: Klein and Morelli, Aircraft System Identification, 2nd ed., chapters 5, 6 and 11; Ljung
    (1999), System Identification, 2nd ed., sections 16.4 to 16.6; Jategaonkar (2006), Flight
    Vehicle System Identification, chapter 11; Burnham and Anderson (2002), Model Selection and
    Multimodel Inference.
    """
    check_fits(fits)
    _check_labels(labels, len(fits))
    require_lengths(
        **{name: v for name, v in (("window", window), ("lead", lead)) if v is not None}
    )
    names = tuple(labels) or labels_of(fits)
    held_out = _as_records(records)
    require_known(
        removed_at or {},
        {name: None for fit in fits for name in fit.free},
        "free parameter",
        "each fit",
    )

    own = require_own(fits, own)

    different = data_difference(fits, names)
    if different and not held_out:
        raise ValueError(
            f"{different}: fit them to the same data, or give records=[...] on which to judge them."
        )
    same_data = not different
    not_comparable = different or why_not_comparable(fits, names)
    comparable = not not_comparable
    notes = list(not_held_out(fits, names, held_out))

    data: dict[str, list[list[Record]]] = {}  # of every fit
    if same_data and fits[0].records:
        data[IDENTIFICATION] = [[part.data for part in fit.records] for fit in fits]
    if held_out:
        data[HELD_OUT] = [held_out] * len(fits)
    lengths = window_lengths(
        fits, [record for of_fits in data.values() for record in of_fits[0]], window, lead
    )

    predictions: dict[str, Predictions] = {}
    for kind, of_fits in data.items():
        fitted = kind == IDENTIFICATION
        predictions[kind], said = predict_same_windows(
            fits, names, of_fits, lengths, fitted=fitted, own=own
        )
        notes += said

    is_known = comparable and all(is_likelihood(fit) for fit in fits)
    likelihoods = common_likelihood(fits) if same_data and not is_known else None
    rows = fit_rows(fits, same_data=same_data, comparable=comparable, likelihoods=likelihoods)
    for kind, of_fits in predictions.items():
        rows += prediction_rows(kind, of_fits, fits)
    said, tests = verdicts(
        fits,
        names,
        predictions,
        same_data=same_data,
        comparable=comparable,
        removed_at=removed_at,
        likelihoods=likelihoods,
        aic=_known("AIC", rows),
    )
    if folds is not None:
        if different:
            raise ValueError(f"{different}: folds need fits of the same data.")
        left_out, predicted = cross_validation(fits, names, folds)
        rows += left_out
        said = (*said, *predicted)
    notes += (
        [_costs_not_compared(not_comparable, fits, likelihoods)]
        if same_data and not comparable
        else []
    )
    supported, verdict = _parsimony(names, fits, rows, tests)
    first = next(
        (p for of_fits in predictions.values() for p in of_fits[0] if p.data.has_time), None
    )
    return Comparison(
        labels=names,
        data=shared_data(fits) if same_data else f"{different}: their costs are not compared",
        rows=tuple(rows),
        statements=(*notes, *said),
        window=first.horizon if first else None,
        lead=first.lead if first else None,
        windows={kind: sum(len(p) for p in of_fits[0]) for kind, of_fits in predictions.items()},
        predictions=predictions,
        supported=supported,
        verdict=verdict,
    )


def _parsimony(
    names: Sequence[str], fits: Sequence[Fit], rows: Sequence[Row], tests: Mapping[Pair, Evidence]
) -> tuple[str, str]:
    """Return the label and the sentence of the smallest structure that the data support; empty where it is not known.

    The likelihood of records assumes white residuals, which are seldom so white that differences of
    BIC could be believed: there the tests, which allow for it, stand alone.
    """
    bic = _known("BIC", rows)
    if not bic or any(part.data.has_time for fit in fits for part in fit.records):
        return "", ""
    k, sentence = parsimony(names, bic, [len(fit.free) for fit in fits], tests)
    return names[k], sentence


def _known(measure: str, rows: Sequence[Row]) -> list[float]:
    """Return a measure of all fits; empty where one of them has none."""
    values = next(row.values for row in rows if (row.data, row.measure) == ("fit", measure))
    return [] if None in values else [value for value in values if value is not None]


def _check_labels(labels: Sequence[str], count: int) -> None:
    texts = (
        isinstance(labels, Sequence)
        and not isinstance(labels, str)
        and all(isinstance(n, str) for n in labels)
    )
    if not texts or (labels and len(set(labels)) != count):
        raise ValueError(
            f"labels is {labels!r:.80}: give a list of {count} different texts, one for each fit."
        )


def _as_records(given: Any) -> list[Record]:
    """Return the held-out records that a user gives: none, one, or several."""
    if given is None:
        return []
    if isinstance(given, Record):
        return [given]
    if not isinstance(given, Sequence) or not all(isinstance(item, Record) for item in given):
        raise TypeError(f"records is {given!r:.80}: give a Record or a list of them.")
    return list(given)


def _costs_not_compared(reason: str, fits: Sequence[Fit], likelihoods: Likelihoods | None) -> str:
    what = "Costs, AIC and BIC are" if likelihoods is None else "Costs are"
    more = (
        "; the table has each criterion for all of them" if any(fit.costs for fit in fits) else ""
    )
    return f"{what} not compared: {reason}{more}."
