"""Intervals that need not be symmetric: profiles that the fit holds, and a bootstrap of it."""

from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree.ElementTree import Element

from greybox.estimate.profiles import Profiles
from greybox.estimate.result import Fit
from greybox.files.text_table import counted
from greybox.html_report.elements import tag
from greybox.html_report.figure import figure_grid
from greybox.html_report.tables import Cell, number_cell, table
from greybox.plotting.profile import profile_figures
from greybox.study.bootstrap import interval_text


def interval_section(fit: Fit, bootstrap: Mapping[str, Any]) -> Iterator[Element]:
    """Yield the profiles of a fit and its `Bootstrap.summary`, if there are any."""
    if fit.profiles is not None and fit.profiles.profiles:
        yield from _profiles(fit.profiles)
    if bootstrap:
        yield from bootstrap_table(bootstrap)


def _profiles(profiles: Profiles) -> Iterator[Element]:
    percent = f"{100 * profiles.level:g} %"
    rows = [[Cell(p.name), number_cell(p.estimate), Cell(str(p))] for p in profiles.profiles]
    yield table(["quantity", "estimate", f"{percent} interval by profile likelihood"], rows)
    for warning in profiles.warnings:
        yield tag("p", warning)
    yield figure_grid(profile_figures(profiles))
    yield tag(
        "p",
        "r is the signed root of the likelihood ratio; all other parameters are fitted again at "
        "every point. The interval is where |r| stays below the limit. Where the curve leaves the "
        "dashed cone, the standard error misleads.",
        class_="soft",
    )


def bootstrap_table(said: Mapping[str, Any]) -> list[Element]:
    """Return what a bootstrap found as a sentence and a table."""
    failed = f", {said['failed']} failed" if said["failed"] else ""
    about = f"{said['about']}; {counted(int(said['replicates']), 'replicate')}{failed}; seed {said['seed']}"
    rows = []
    for name, q in said["quantities"].items():
        errors = (
            number_cell(q[key], 3) for key in ("standard_error", "fit_standard_error", "bias")
        )
        ends = Cell(interval_text(q["interval"]), (q["interval"] or [None])[0])
        rows.append([Cell(name), number_cell(q["estimate"]), *errors, Cell(q["unit"]), ends])
    percent = f"{100 * said['level']:g} %"
    header = ["quantity", "estimate", "± error", "± error of the fit", "bias", "unit"]
    found = table([*header, f"{percent} interval"], rows)
    return [tag("p", f"Bootstrap: {about}."), found, *(tag("p", text) for text in said["warnings"])]
