"""Intervals that need not be symmetric: profiles that the fit holds, and a bootstrap of it."""

from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from greybox.estimate.profiles import Profiles
from greybox.estimate.result import Fit
from greybox.files.text_table import counted
from greybox.html_report.elements import tag
from greybox.html_report.figure import Figure, Panel, Series, figure_grid
from greybox.html_report.tables import Cell, number_cell, table
from greybox.study.bootstrap import interval_text

GRAY = -1


def interval_section(fit: Fit, bootstrap: Mapping[str, Any]) -> Iterator[Element]:
    """Yield what there is: the profiles of a fit, and what `Bootstrap.summary` says of it."""
    if fit.profiles is not None and fit.profiles.profiles:
        yield from _profiles(fit.profiles)
    if bootstrap:
        yield from bootstrap_table(bootstrap)


def profile_figures(found: Profiles) -> Iterator[Figure]:
    """Yield the root of the likelihood ratio over every profiled quantity, beside the one of the standard error."""
    for profile in found.profiles:
        name, limit = profile.name, found.limit[profile.name]
        ends = profile.values[[0, -1]]
        sides = np.array([ends[0], profile.estimate, profile.estimate, ends[1]])
        inside = np.where(np.isfinite(profile.interval), profile.interval, ends)
        series = [
            Series(
                "interval", "band", inside, np.zeros(2), 0, low=np.zeros(2), high=np.full(2, limit)
            ),
            Series("limit", "line", sides, limit + profile.bias * np.array([1, 1, -1, -1]), GRAY),
        ]
        if profile.standard_error > 0:
            reached = np.array([-1, 0, 1]) * 1.6 * limit
            cone = profile.estimate + profile.standard_error * reached
            series.append(Series("by the standard error", "line", cone, np.abs(reached), GRAY, 1))
        size = np.abs(profile.roots)
        series += [
            Series("profile", "line", profile.values, size),
            Series("", "points", profile.values, size),
        ]
        label = f"{name}, {profile.unit}" if profile.unit else name
        panel = Panel("|r|", series, limits=(0.0, 1.6 * limit))
        yield Figure(f"Profile of {name}", label, [panel], limits=(float(ends[0]), float(ends[1])))


def _profiles(found: Profiles) -> Iterator[Element]:
    percent = f"{100 * found.level:g} %"
    rows = [[Cell(p.name), number_cell(p.estimate), Cell(str(p))] for p in found.profiles]
    yield table(["quantity", "estimate", f"{percent} interval by profile likelihood"], rows)
    for warning in found.warnings:
        yield tag("p", warning)
    yield figure_grid(list(profile_figures(found)))
    yield tag(
        "p",
        "r is the signed root of the likelihood ratio, all other parameters fitted again at every point; the interval "
        "is where it stays below the limit. Where the curve leaves the dashed cone, the standard error misleads.",
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
