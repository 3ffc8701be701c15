"""What was fitted to what, and how: sources, checksums, seed, versions, in the words that the result holds."""

import math
import shlex
from collections.abc import Sequence
from xml.etree.ElementTree import Element

from greybox.estimate.fitted_part import FittedRecord, FittedResponse, FittedSpectrum
from greybox.estimate.printed import data_text, error_statement
from greybox.estimate.result import Fit
from greybox.files.text_table import counted, number
from greybox.html_report.elements import Child, tag
from greybox.html_report.tables import Cell, number_cell, table

# What the numbers of each kind of data are called.
_NOUNS = {FittedResponse: "point", FittedRecord: "sample", FittedSpectrum: "line"}


def data_summary(fit: Fit) -> str:
    """Say in one sentence which model was fitted to which data."""
    models = ", ".join(dict.fromkeys(part.label for part in fit.parts))
    free = counted(len(fit.free), "free parameter")
    return f"{models} with {free}, fitted to {data_text(fit)} by {fit.rule}."


def provenance(fit: Fit, file: str = "", command: Sequence[str] = ()) -> list[Element]:
    """Return how a fit came about, and where its data come from; `command` made more than this fit."""
    made_by = command or fit.command
    facts: list[tuple[str, Child]] = []
    if file:
        facts.append(("result file", file))
    facts += [
        (
            "made by",
            tag("code", shlex.join(["greybox", *made_by])) if made_by else "gb.fit, from Python",
        ),
        ("cost", f"{number(fit.cost, 6)} ({fit.rule})"),
        ("delay", fit.delay),
        (
            "starts",
            f"{fit.starts}; {len(fit.runs)} runs, {sum(run.converged for run in fit.runs)} converged",
        ),
        ("seed", "none" if fit.seed is None else str(fit.seed)),
        ("time taken", f"{fit.seconds:.2f} s"),
        ("versions", ", ".join(f"{name} {version}" for name, version in fit.versions.items())),
    ]
    if fit.dof > 0:
        facts.append(("standard errors", error_statement(fit)))
    others = [
        f"{name} {number(cost)}" for name, cost in fit.costs.items() if _is_other(fit, name, cost)
    ]
    if others:
        facts.append(("other criteria", f"{', '.join(others)} at this estimate"))
    return [description(facts), _data_table(fit), *_restrictions(fit)]


def description(facts: list[tuple[str, Child]]) -> Element:
    """Return a list of terms with what they are."""
    return tag("dl", *(part for term, text in facts for part in (tag("dt", term), tag("dd", text))))


def _is_other(fit: Fit, name: str, cost: float) -> bool:
    return name != fit.criterion and math.isfinite(cost)


def _data_table(fit: Fit) -> Element:
    rows = []
    for part in fit.parts:
        data = part.data
        size = counted(len(data), _NOUNS[type(part)])
        rows.append(
            [
                Cell(part.name or data.name or "–"),
                Cell(part.label),
                Cell(_signals(part)),
                Cell(size, float(len(data))),
                Cell(_span(part)),
                Cell(part.criterion),
                number_cell(part.weight),
                Cell(data.source or "–"),
                Cell(tag("code", data.checksum), mark="prose"),
            ]
        )
    header = [
        "data",
        "model",
        "signals",
        "size",
        "span",
        "criterion",
        "weight",
        "source",
        "checksum (SHA-256)",
    ]
    return table(header, rows)


def _signals(part: FittedResponse | FittedRecord | FittedSpectrum) -> str:
    if isinstance(part, FittedSpectrum):
        return f"{', '.join(part.data.inputs)} → {', '.join(part.outputs)}"
    if isinstance(part, FittedRecord):
        inputs = [name for name in part.data.signals if name not in part.outputs]
        return f"{', '.join(inputs) or 'no input'} → {', '.join(part.outputs)}"
    known = part.curve or part.data
    return f"{known.input or 'input'} → {known.output or 'output'}"


def _span(part: FittedResponse | FittedRecord | FittedSpectrum) -> str:
    if not isinstance(part, FittedRecord):
        return f"{part.data.omega.min():.3g} to {part.data.omega.max():.3g} rad/s"
    return (
        f"{part.data.duration:.4g} s at {part.data.rate:.4g} Hz"
        if part.data.has_time
        else "rows without a time"
    )


def _restrictions(fit: Fit) -> list[Element]:
    """Return ties, constraints, names and settings, as far as there are any."""
    facts: list[tuple[str, Child]] = []
    for part in fit.parts:
        where = f" of {part.name}" if len(fit.parts) > 1 else ""
        facts += [(f"tied {name}{where}", tag("code", text)) for name, text in part.tied.items()]
        facts += [(f"constraint{where}", tag("code", text)) for text in part.constraints]
        if part.rename:
            names = ", ".join(f"{inside} is {outside}" for inside, outside in part.rename.items())
            facts.append((f"names{where}", names))
        if not isinstance(part, FittedRecord) and part.at:
            facts.append(
                (
                    f"operating point{where}",
                    ", ".join(f"{name} = {v:.5g}" for name, v in part.at.items()),
                )
            )
        if isinstance(part, FittedRecord):
            facts.append((f"solved by{where}", part.method))
            facts += [(f"input {name}{where}", text) for name, text in part.between.items()]
    return [description(facts)] if facts else []
