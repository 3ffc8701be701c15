"""The structures of an order selection: what more parameters buy."""

from typing import Any

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from greybox.files.text_table import counted
from greybox.identification.orders import OrderSelection
from greybox.plotting.style import (
    DARK,
    GRAYS,
    MARKERS,
    color_of,
    finish,
    flat_axes,
    label_horizontal,
    legend_inside,
    new_figure,
)
from greybox.validation.parsimony import BARE_MENTION

NEAR = 10.0  # BIC above the least up to which a structure is named: beyond it the evidence is very strong


def orders(found: OrderSelection, ax: Axes | None = None, legend: bool = True) -> Axes:
    """Draw how far BIC lies above the least over the number of parameters, with n, m at the best of each number.

    Parameters
    ----------
    found : OrderSelection
    ax : Axes, optional
        Without it a new figure is made.
    legend : bool
        False leaves the legend out.
    """
    if ax is None:
        ax = new_figure(6.4, 4.2).subplots()
    else:
        flat_axes(ax)
    least = found.least.bic
    groups = list(dict.fromkeys((c.integrators, c.delay) for c in found.candidates))
    entries: dict[str, tuple[Artist, ...]] = {}
    for k, group in enumerate(sorted(groups)):
        members = [c for c in found.candidates if (c.integrators, c.delay) == group]
        style: dict[str, Any] = {
            "color": color_of(k),
            "marker": MARKERS[k % len(MARKERS)],
            "linestyle": "none",
        }
        ax.plot(
            [c.parameters for c in members], [c.bic - least for c in members], markersize=5, **style
        )
        name = counted(group[0], "integrator") if group[0] else "no integrator"
        entries[f"{name}{', delay' if group[1] else ''}"] = (Line2D([], [], **style),)
    ax.set_yscale("symlog", linthresh=NEAR)
    ax.axhline(BARE_MENTION, color=GRAYS[0], linewidth=0.8, linestyle="--")
    chosen = found.chosen
    (ring,) = ax.plot(
        chosen.parameters,
        chosen.bic - least,
        "o",
        markersize=12,
        markerfacecolor="none",
        color=DARK,
    )
    entries["chosen"] = (ring,)
    best = {
        c.parameters: c for c in reversed(found.candidates)
    }  # of each number, those of one are sorted by BIC
    for c in best.values():
        if c.bic - least <= NEAR:
            place = (c.parameters, c.bic - least)
            ax.annotate(
                f"{c.n}, {c.m}",
                place,
                xytext=(-8, 7),
                textcoords="offset points",
                ha="right",
                fontsize=8,
                color=DARK,
            )
    ax.set_ylim(bottom=-0.6)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    label_horizontal([ax], "parameters (labels: n, m)")
    finish(ax, "BIC above the least")
    if legend:
        legend_inside(ax, entries)
    return ax
