"""Which model was fitted to which data, and how: sources, checksums, seed, versions."""

import math
import shlex
from collections.abc import Mapping
from xml.etree.ElementTree import Element

from greybox.estimate import printed
from greybox.estimate.fitted_part import FittedRecord
from greybox.estimate.result import Fit
from greybox.files.text_table import counted, number
from greybox.html_report.elements import Child, tag
from greybox.html_report.tables import Cell, number_cell, table


def data_summary(fit: Fit) -> str:
    """Say in one sentence which model was fitted to which data."""
    models = ", ".join(dict.fromkeys(part.label for part in fit.parts))
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
            Cell(part.name or part.data.name or "–"),
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
            facts |= {f"input {name}{place}": text for name, text in part.between.items()}
        elif part.at:
            facts[f"operating point{place}"] = ", ".join(
                f"{name} = {value:.5g}" for name, value in part.at.items()
            )

    return [_description(facts)] if facts else []
