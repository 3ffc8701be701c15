"""Fits side by side: on their own data and on records that none of them has seen."""

from collections.abc import Sequence
from typing import Any

from greybox.assessment.result import Fits
from greybox.assessment.simulation.prediction import require_lengths
from greybox.assessment.validation.comparison import (
    HELD_OUT,
    IDENTIFICATION,
    SIGNIFICANT,
    Comparison,
    Row,
)
from greybox.assessment.validation.held_out import (
    Predictions,
    damaged,
    not_held_out,
    predict_same_windows,
    window_lengths,
)
from greybox.assessment.validation.measures import fit_rows, prediction_rows
from greybox.assessment.validation.nested_models import NestedTest
from greybox.assessment.validation.parsimony import parsimony
from greybox.assessment.validation.same_data import (
    check_fits,
    data_difference,
    labels_of,
    shared_data,
    why_not_comparable,
)
from greybox.assessment.validation.significance import (
    residuals_not_white,
    verdicts,
    which_likelihood,
)
from greybox.data.files.argument_checks import checked_items
from greybox.data.files.public import public
from greybox.data.record import Record


@public
def compare(
    *fits: Any,
    records: Record | Sequence[Record] | None = None,
    window: float | None = None,
    lead: float | None = None,
    labels: Sequence[str] = (),
) -> Comparison:
    """Compare fits of different structures: which one describes the data best, which predicts best.

    The table has cost, number of parameters, AIC, AICc and BIC if the fits have the same data and
    their costs are likelihoods, as those of records are. Fits of frequency responses may have
    different criteria: AIC, AICc and BIC then belong to one likelihood, maximized from every
    estimate: `MaximumLikelihood` if the data have variances, otherwise `RelativeLikelihood`. The
    first sentence names the smallest structure that the data support: the one with the fewest
    parameters among those whose BIC is within 2 of the least. If no model explains its data, it
    says so. Models of records are judged by their
    predictions of the same windows, see `predict`, on the data of the fits and on `records`.
    Windows in which a model has no finite value are left out for all models and counted.

    If one model is another one with terms removed, `nested_test` compares them. Other models of
    responses are compared by AIC; a difference below 2 prefers neither (Burnham and Anderson,
    section 2.6). Two models predict equally well if their mean squared errors differ by less than
    0.1 %, or if no test finds a difference and its 95 % interval is within 10 %.

    Parameters
    ----------
    *fits : Fit, or a single Study
        The structures of a study are compared over its data sets, see `Study.ranking`.
    records : Record or sequence of them, optional
        Held out from all fits. Without them the fits must have the same data. Members of a study
        state them as `held`.
    window, lead : float, s
        Length of the predictions, and of the data before them from which the state is estimated.
        By default 1 s and 0.5 s, each at most an eighth of the shortest record, or 10 samples of
        the slowest record if that is longer; the lead is also at least twice the longest delay.
        Rows without a time are predicted one by one.
    labels : sequence of str, optional
        One for each fit; by default the names of the models.

    Raises
    ------
    TypeError, ValueError
        For other objects, a fit without an estimate, different data without records, records that
        do not match the models, lengths shorter than a sample, or a model without finite values in
        half of the windows.

    Sources: Klein and Morelli, Aircraft System Identification, 2nd ed., chapters 5, 6 and 11; Ljung
    (1999), System Identification, 2nd ed., sections 16.4 to 16.6; Jategaonkar (2006), Flight
    Vehicle System Identification, chapter 11; Burnham and Anderson (2002), Model Selection and
    Multimodel Inference.

    Examples
    --------
    >>> from greybox.models.rate import DampedAngle
    >>> from greybox.problems import sitl_pitch
    >>> damped = gb.Problem(DampedAngle(), sitl_pitch.data(), criterion=gb.RelativeLikelihood())
    >>> fits = gb.fit(damped, starts=8), gb.fit(damped.with_(fixed={"a": 0.0}), starts=8)
    >>> gb.compare(*fits, labels=["damped", "undamped"]).supported
    'damped'
    """
    if len(fits) == 1 and hasattr(fits[0], "ranking"):
        if records:
            raise ValueError("records=[...] are for fits: the members of a study state held=[...].")
        return fits[0].ranking()
    check_fits(fits)
    if labels and (isinstance(labels, str) or len({*map(str, labels)}) != len(fits)):
        raise ValueError(
            f"labels is {labels!r:.80}: give a list of {len(fits)} different texts, one for each "
            "fit."
        )
    require_lengths(window=window, lead=lead)
    names = tuple(map(str, labels)) or labels_of(fits)
    held_out = []
    if records is not None:
        held_out = checked_items("records", records, Record, "a Record or a list of them")

    different = data_difference(fits, names)
    if different and not held_out:
        raise ValueError(
            f"{different}: fit them to the same data, or judge them on others, records=[...]."
        )
    not_comparable = different or why_not_comparable(fits, names)
    predictions, notes = _predictions(fits, names, held_out, (window, lead), not different)

    rows, likelihoods = fit_rows(fits, same_data=not different, comparable=not not_comparable)
    for kind, of_fits in predictions.items():
        rows += prediction_rows(kind, of_fits, fits)
    statements, tests = verdicts(
        fits, names, predictions, same_data=not different, aic=_known("AIC", rows)
    )
    if not not_comparable:
        statements += residuals_not_white(fits, names)
    if likelihoods:
        statements.append(which_likelihood(names, likelihoods))
    notes = [*not_held_out(fits, names, held_out), *damaged(fits, held_out), *notes]
    if not_comparable and not different:
        what = "Costs, AIC and BIC" if likelihoods is None else "Costs"
        notes.append(f"{what} are not compared: {not_comparable}.")

    supported, verdict, statements = _conclusion(fits, names, rows, statements, tests)
    return Comparison(
        labels=names,
        data=f"{different}: their costs are not compared" if different else shared_data(fits),
        rows=tuple(rows),
        statements=(*notes, *statements),
        predictions=predictions,
        supported=supported,
        verdict=verdict,
    )


def _conclusion(
    fits: Fits,
    names: Sequence[str],
    rows: Sequence[Row],
    statements: list[str],
    tests: Sequence[NestedTest],
) -> tuple[str, str, list[str]]:
    """Return the label of the supported fit, the reason, and the statements besides the reason."""
    bic = _known("BIC", rows)
    supported = verdict = ""
    # The likelihood of records assumes white residuals. Real ones are correlated, which inflates
    # differences of BIC: for records only the tests count, which allow for it.
    has_records = any(part.data.has_time for fit in fits for part in fit.records)
    if bic and not has_records:
        k, verdict = parsimony(names, bic, [len(fit.free) for fit in fits], tests)
        supported = names[k]
    elif statements:
        # A single test decides between two fits.
        if len(fits) == 2 and tests:
            [test] = tests
            supported = test.large if test.p_value < SIGNIFICANT else test.small
        verdict, *statements = statements
    if not any(fit.is_explained for fit in fits):
        verdict = f"None of these models explains its data. {verdict}".rstrip()
    return supported, verdict, statements


def _predictions(
    fits: Fits,
    names: Sequence[str],
    held_out: Sequence[Record],
    lengths: tuple[float | None, float | None],
    same_data: bool,
) -> tuple[dict[str, Predictions], list[str]]:
    """Return the predictions of all fits by kind of data, and notes on them."""
    # The records of every fit, by kind of data.
    records_by_fit: dict[str, list[Sequence[Record]]] = {}
    if same_data and fits[0].records:
        records_by_fit[IDENTIFICATION] = [[part.data for part in fit.records] for fit in fits]
    if held_out:
        records_by_fit[HELD_OUT] = [held_out] * len(fits)
    # All fits have the same samples, so those of the first determine the lengths.
    records: list[Record] = []
    for by_fit in records_by_fit.values():
        records += by_fit[0]
    window, lead = lengths
    window_and_lead = window_lengths(fits, records, window, lead)

    predictions: dict[str, Predictions] = {}
    notes: list[str] = []
    for kind, by_fit in records_by_fit.items():
        predictions[kind], texts = predict_same_windows(
            fits, names, by_fit, window_and_lead, fitted=kind == IDENTIFICATION
        )
        notes += texts
    return predictions, notes


def _known(measure: str, rows: Sequence[Row]) -> list[float]:
    """Return a measure of all fits; empty if a fit lacks it."""
    [row] = [row for row in rows if row.data == "fit" and row.measure == measure]
    known = [value for value in row.values if value is not None]
    return known if len(known) == len(row.values) else []
