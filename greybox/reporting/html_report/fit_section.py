"""Everything that the page shows of one fit.

Which model was fitted to which data, and how: sources, checksums, seed, versions.

One result on a page.
"""

import math
import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import field
from inspect import getsource
from textwrap import dedent
from typing import Any
from xml.etree.ElementTree import Element

from greybox.assessment import printed
from greybox.assessment.fitted_part import FittedRecord
from greybox.assessment.profile_result import Profiles
from greybox.assessment.result import Fit
from greybox.assessment.verdict import verdict
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import grouped
from greybox.data.files.numbers_in_text import number
from greybox.data.files.wording import counted
from greybox.modeling.transfer_function import TransferFunction
from greybox.reporting.html_report.elements import (
    COLUMNS,
    Cell,
    Child,
    description,
    figure_grid,
    number_cell,
    parameter_table,
    table,
    tag,
)
from greybox.reporting.plotting.overview import response_figures
from greybox.reporting.plotting.profile import profile_figures
from greybox.reporting.plotting.residuals import residual_figures, shape_figures
from greybox.reporting.plotting.spectrum import spectrum_figure
from greybox.reporting.plotting.starts import starts_figure
from greybox.reporting.plotting.time_history import history_figure


def data_summary(fit: Fit) -> str:
    """Say in one sentence which model was fitted to which data."""
    models = ", ".join(fit.labels)
    free = counted(len(fit.free), "free parameter")
    return f"{models} with {free}, fitted to {printed.data_text(fit)} by {fit.rule}."


def provenance(fit: Fit) -> list[Element]:
    """Return how a fit was made, and where its data come from."""
    # A publication may state the cost of another criterion than the one that was minimized.
    other_costs = [
        f"{name} {number(cost)}"
        for name, cost in fit.costs.items()
        if name != fit.criterion and math.isfinite(cost)
    ]

    facts: dict[str, Child] = {}
    if fit.command:
        facts["made by"] = tag("code", shlex.join(["greybox", *fit.command]))
    facts |= printed.facts(fit)
    facts |= {
        "seed": "none" if fit.seed is None else str(fit.seed),
        "versions": ", ".join(f"{name} {version}" for name, version in fit.versions.items()),
    }
    if fit.directions:
        facts["standard errors"] = printed.error_statement(fit)
    if other_costs:
        facts["other criteria"] = f"{', '.join(other_costs)} at this estimate"

    return [_description(facts), _data_table(fit), *_restrictions(fit)]


def _description(facts: Mapping[str, Child]) -> Element:
    """Return a list of terms with their descriptions."""
    return tag("dl", [(tag("dt", term), tag("dd", text)) for term, text in facts.items()])


def _data_table(fit: Fit) -> Element:
    rows = [
        [
            Cell(part.name),
            Cell(part.label),
            Cell(part.signal_path),
            Cell(counted(len(part.data), *part.nouns[:2]), float(len(part.data))),
            Cell(part.extent),
            Cell(part.criterion),
            number_cell(part.weight),
            Cell(part.data.source or "–"),
            Cell(tag("code", part.data.checksum), mark="prose"),
        ]
        for part in fit.parts
    ]
    header = ["data", "model", "signals", "size", "span", "criterion", "weight", "source"]
    return table([*header, "checksum (SHA-256)"], rows)


def _restrictions(fit: Fit) -> list[Element]:
    """Return ties, constraints, names and settings, if there are any."""
    # What a reader needs to repeat the fit, besides data, model and criterion.
    facts: dict[str, Child] = {}
    for part in fit.parts:
        place = f" of {part.name}" if len(fit.parts) > 1 else ""
        facts |= {f"tied {name}{place}": tag("code", text) for name, text in part.tied.items()}
        if part.constraints:
            facts[f"constraints{place}"] = [
                tag("div", tag("code", text)) for text in part.constraints
            ]
        if part.rename:
            facts[f"names{place}"] = ", ".join(
                f"{inside} is {outside}" for inside, outside in part.rename.items()
            )
        if isinstance(part, FittedRecord):
            facts[f"solved by{place}"] = part.method
            facts |= {f"clock{place}": part.gaps} if part.gaps else {}
            facts |= {f"input {name}{place}": text for name, text in part.between.items()}
        elif part.at:
            facts[f"operating point{place}"] = ", ".join(
                f"{name} = {value:.5g}" for name, value in part.at.items()
            )

    return [_description(facts)] if facts else []


@frozen
class Entry:
    """One result on the page.

    Attributes
    ----------
    label : str
        Its name on the page.
    fit : Fit or None
        None if the page shows no details.
    answer : mapping
        `Fit.to_dict` of the result; empty if there is none.
    error : str
        Why there is no result.
    """

    label: str
    fit: Fit | None
    answer: Mapping[str, Any] = field(default_factory=dict)
    error: str = ""

    @property
    def anchor(self) -> str:
        """Identifier of the section with details; empty if there is none."""
        return "" if self.fit is None else "result-" + re.sub(r"\W+", "-", self.label)


MOST = 6  # parts of a fit that are drawn; of records those with the worst fit


def fit_section(entry: Entry) -> Iterator[tuple[str, list[Element]]]:
    """Yield title and content of the sections of one result."""
    # The verdict first: a colleague may read no further.
    fit = entry.fit
    assert fit is not None
    judged = verdict(fit)
    sentences = [tag("p", tag("strong", judged.level)), *(tag("p", s) for s in judged.sentences)]
    box = tag("div", sentences, class_=f"verdict {judged.grade}")
    yield "Verdict", [tag("p", data_summary(fit)), box, *_warnings(fit)]
    yield "Parameters", [parameter_table(fit), *remarks(fit)]
    if fit.profiles is not None and fit.profiles.profiles:
        yield "Intervals", list(_profiles(fit.profiles))
    yield "Equation", list(_equations(fit))
    if fit.responses:
        yield "Frequency response", [figure_grid(response_figures([fit]))]
    if fit.records:
        yield "Time history", list(_histories(fit))
    if fit.spectra:
        count = min(len(fit.spectra), MOST)
        yield "Manoeuvres", [figure_grid([spectrum_figure(fit, k) for k in range(count)])]

    yield "Starts", [figure_grid([starts_figure(fit)])]
    yield "Data and provenance", provenance(fit)


def _warnings(fit: Fit) -> list[Element]:
    items = [tag("li", cause.remedy) for cause in (fit.misfit.likely if fit.misfit else ())]
    items += [tag("li", text, class_="warning") for text in fit.warnings]
    items += [tag("li", text, class_="note") for text in fit.notes]
    return [tag("ul", items, class_="warnings")] if items else []


def remarks(fit: Fit) -> list[Element]:
    """Return what the columns of the table mean, and combinations."""
    # Without a covariance there is nothing to remark.
    if fit.directions is None:
        return []

    texts = [
        "CR is the Cramér-Rao bound: the standard error in percent of the value (guideline: at "
        "most 20 %). Insensitivity is the same if all other parameters were known (at most 10 %). "
        "! marks larger values."
    ]
    if combinations := fit.identifiability.combinations:
        texts.append(f"Determined in combination: {'; '.join(map(str, combinations))}.")
    return [tag("p", text, class_="soft") for text in texts]


def _profiles(profiles: Profiles) -> Iterator[Element]:
    rows = [[Cell(p.name), number_cell(p.estimate), Cell(str(p))] for p in profiles.profiles]
    interval = f"{100 * profiles.level:g} % interval by profile likelihood"
    yield table(["quantity", "estimate", interval], rows)
    for warning in profiles.warnings:
        yield tag("p", warning)
    yield figure_grid(profile_figures(profiles))
    explanation = (
        "r is the signed root of the likelihood ratio. At every point all other parameters are "
        "fitted again. The interval contains the values for which |r| is below the limit. Where "
        "the curve leaves the dashed cone, the standard error misleads."
    )
    yield tag("p", explanation, class_="soft")


def _equations(fit: Fit) -> Iterator[Element]:
    """Yield the description of every model by its author, and its formula as it is programmed."""
    # Several records of one model have one equation: take the first part.
    for (k, part), *_ in grouped(enumerate(fit.parts), lambda numbered: numbered[1].label):
        yield tag("h4", part.label)
        yield from description(part.equation)
        try:
            model: Any = fit.model_of(k)
            is_ratio = isinstance(model, TransferFunction)
            methods = [model.response] if is_ratio else [model.derivative, model.output]
            yield tag("pre", "\n".join(dedent(getsource(method)) for method in methods))
        except (LookupError, ValueError, TypeError, OSError) as error:
            reason = str(error.args[0] if error.args else type(error).__name__).rstrip(".")
            yield tag("p", f"The formula is not available: {reason}.")


def _histories(fit: Fit) -> Iterator[Element]:
    """Yield time histories and residuals, of many records those with the worst fit."""

    # The worst records show what the model misses; a page with a hundred records loads slowly.
    def fit_percent(k: int) -> float:
        part = fit.records[k]
        return min(map(part.fit_percent, part.outputs))

    count = len(fit.records)
    chosen = sorted(sorted(range(count), key=fit_percent)[:MOST])
    if count > MOST:
        yield tag("p", f"Of {count} records, the {MOST} with the worst fit are drawn.")
    yield figure_grid([history_figure([fit], k, columns=COLUMNS) for k in chosen])
    if fit.converged:
        figures = [figure for k in chosen for figure in residual_figures(fit.records[k])]
        yield figure_grid([*shape_figures(fit), *figures])
