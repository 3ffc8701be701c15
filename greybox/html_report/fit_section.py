"""All that the page shows of one fit."""

from collections.abc import Iterator, Mapping, Sequence
from xml.etree.ElementTree import Element

from greybox.estimate.fitted_part import FittedResponse
from greybox.estimate.result import Fit
from greybox.estimate.verdict import verdict
from greybox.files.text_table import counted, listed
from greybox.html_report.elements import tag
from greybox.html_report.entry import Entry
from greybox.html_report.equation import equations
from greybox.html_report.figure import figure_grid
from greybox.html_report.interval_section import interval_section
from greybox.html_report.provenance import data_summary, provenance
from greybox.html_report.tables import parameter_table
from greybox.modeling.model import Model
from greybox.plotting.bode import bode_figure
from greybox.plotting.figure import Figure
from greybox.plotting.nyquist import nyquist_figures
from greybox.plotting.residuals import residual_figures
from greybox.plotting.sensitivity import information_figure, response_sensitivity_figure
from greybox.plotting.spectrum import spectrum_figure
from greybox.plotting.starts import starts_figure
from greybox.plotting.time_history import history_figure

MOST = 6  # parts of a fit that are drawn; of records those with the worst fit


def fit_section(entry: Entry, columns: int) -> Iterator[tuple[str, list[Element]]]:
    """Yield title and content of the sections of a result with a fit; `columns` of long lines are drawn."""
    fit = entry.fit
    assert fit is not None
    yield "Verdict", [tag("p", data_summary(fit)), verdict_box(fit), *_warnings(fit)]
    yield "Parameters", [parameter_table(fit), *_remarks(fit)]
    intervals = list(interval_section(fit, entry.bootstrap))
    if intervals:
        yield "Intervals", intervals
    yield "Equation", list(_equations(fit))
    if fit.responses:
        drawn = [bode_figure([fit]), *nyquist_figures([fit])]
        yield "Frequency response", [figure_grid(drawn), *_sensitivities(fit)]
    if fit.records:
        yield "Time history", list(_histories(fit, columns))
    if fit.spectra:
        count = min(len(fit.spectra), MOST)
        yield "Manoeuvres", [figure_grid([spectrum_figure(fit, k) for k in range(count)])]
    drawn = _information(fit)
    if drawn:
        yield "Information in the data", [figure_grid(drawn)]
    yield "Starts", [figure_grid([starts_figure(fit)])]
    yield "Data and provenance", provenance(fit, entry.file, entry.command)


def verdict_box(fit: Fit) -> Element:
    """Return the verdict in its frame."""
    judged = verdict(fit)
    return tag(
        "div", *(tag("p", text) for text in judged.sentences), class_=f"verdict {judged.grade}"
    )


def _warnings(fit: Fit) -> list[Element]:
    kinds = [*((text, "warning") for text in fit.warnings), *((text, "note") for text in fit.notes)]
    return (
        [tag("ul", *(tag("li", text, class_=kind) for text, kind in kinds), class_="warnings")]
        if kinds
        else []
    )


def _remarks(fit: Fit) -> list[Element]:
    """Return what the columns mean, and correlations and combinations."""
    if not fit.converged:
        return []
    told = [
        "CR is the Cramér-Rao bound, the standard error in percent of the value (guideline: at most 20 %); "
        "insensitivity is what it would be if all other parameters were known (at most 10 %). An exclamation mark is "
        "beyond."
    ]
    if fit.profiles is not None and fit.profiles.profiles:
        told.append(
            "The intervals here are those of the standard errors, which mislead for "
            f"{listed([p.name for p in fit.profiles.profiles])}: see Intervals."
        )
    try:
        judged = fit.identifiability
    except ValueError:
        return []
    if judged.correlated:
        pairs = ", ".join(
            f"{a} and {b} ({value:.2f})".replace("-", "−") for a, b, value in judged.correlated
        )
        told.append(f"Correlated beyond 0.9: {pairs}.")
    if judged.combinations:
        told.append(f"Determined in combination: {'; '.join(map(str, judged.combinations))}.")
    return [tag("p", text, class_="soft") for text in told]


def _equations(fit: Fit) -> Iterator[Element]:
    """Yield the equation of every model, or why it cannot be written, and what its author says of it."""
    told: set[str] = set()
    for k, part in enumerate(fit.parts):
        if part.label in told:
            continue
        told.add(part.label)
        yield tag("h4", part.label)
        is_written = True
        try:
            model = fit.model_of(k)
            yield tag("div", equations(model), class_="equations")
            if fit.converged:
                yield tag("p", "With the estimate:", class_="soft")
                yield tag("div", equations(model, _values(fit, k, model)), class_="equations")
        except (LookupError, ValueError, TypeError, ArithmeticError) as error:
            is_written = False
            yield tag("p", f"The equation cannot be written from the formula: {_sentence(error)}")
        if part.equation:
            summary = tag("summary", "What the model's author says of it")
            yield tag("details", summary, tag("pre", part.equation), open=not is_written)


def _values(fit: Fit, k: int, model: Model) -> Mapping[str, float]:
    part = fit.parts[k]
    values = {name: fit.estimate.get(part.rename.get(name, name)) for name in model.parameters}
    return {name: float(f"{value:.4g}") for name, value in values.items() if value is not None}


def _information(fit: Fit) -> list[Figure]:
    try:
        return [information_figure(fit, k) for k in range(min(len(fit.parts), MOST))]
    except ValueError:  # no estimate, or no standard errors
        return []


def _sensitivities(fit: Fit) -> Iterator[Element]:
    """Yield the sensitivity of every model's response, or why it cannot be drawn."""
    told: set[str] = set()
    for k, part in enumerate(fit.parts):
        if not fit.converged or not isinstance(part, FittedResponse) or part.label in told:
            continue
        told.add(part.label)
        try:
            figure = response_sensitivity_figure(fit, part, fit.model_of(k))
        except (LookupError, ValueError, TypeError, ArithmeticError) as error:
            yield tag("p", f"Confidence band and sensitivity cannot be drawn: {_sentence(error)}")
            continue
        if figure is not None:
            yield figure_grid([figure])


def _histories(fit: Fit, columns: int) -> Iterator[Element]:
    """Yield the histories of the records, of many of them those that are fitted worst."""

    def worst(k: int) -> float:
        part = fit.records[k]
        return min(part.fit_percent(name) for name in part.outputs)

    chosen: Sequence[int] = range(len(fit.records))
    if len(chosen) > MOST:
        chosen = sorted(sorted(chosen, key=worst)[:MOST])
        yield tag(
            "p",
            f"Of {counted(len(fit.records), 'record')} the {MOST} that are fitted worst are drawn.",
        )
    labels = [f"fit of {part.label}" for part in fit.records]
    yield figure_grid([history_figure([fit], k, labels[k : k + 1], columns) for k in chosen])
    if fit.converged:
        yield figure_grid([figure for k in chosen for figure in residual_figures(fit.records[k])])


def _sentence(error: Exception) -> str:
    text = str(error.args[0]) if error.args else type(error).__name__
    return text if text.endswith(".") else f"{text}."
