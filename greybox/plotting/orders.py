"""The structures of an order selection: what more parameters buy."""

import numpy as np
from matplotlib.axes import Axes

from greybox.files.text_table import counted
from greybox.identification.orders import OrderCandidate, OrderSelection
from greybox.plotting.figure import Figure, Panel, Series, rule
from greybox.plotting.matplotlib_figure import draw
from greybox.validation.parsimony import BARE_MENTION

NEAR = 10.0  # difference in BIC up to which a structure is labeled: beyond, evidence is very strong


def orders(selection: OrderSelection, ax: Axes | None = None, legend: bool = True) -> Axes:
    """Draw the difference of BIC to the least over the number of parameters.

    The best structure of each number is labeled n, m.

    Parameters
    ----------
    selection : OrderSelection
    ax : Axes, optional
        By default a new figure is made.
    legend : bool
        Draw a legend.
    """
    (drawn,) = draw(orders_figure(selection), ax, legend=legend, inches=3.1)
    drawn.set_yscale("symlog", linthresh=NEAR)
    return drawn


def orders_figure(selection: OrderSelection) -> Figure:
    """Return the structures of an order selection."""
    least = selection.least.bic
    # Candidates of one number of parameters are sorted by BIC.
    best = {c.parameters: c for c in reversed(selection.candidates)}

    def label(candidate: OrderCandidate) -> str:
        orders = f"{candidate.n}, {candidate.m}"
        if candidate is selection.chosen:
            return f"{orders}: chosen"
        is_best = candidate is best[candidate.parameters] and candidate.bic - least <= NEAR
        return orders if is_best else ""

    groups = sorted({(c.integrators, c.delay) for c in selection.candidates})
    series = [rule(BARE_MENTION, style=1)]
    for k, (integrators, delay) in enumerate(groups):
        members = [c for c in selection.candidates if (c.integrators, c.delay) == groups[k]]
        name = counted(integrators, "integrator") if integrators else "no integrator"
        series.append(
            Series(
                f"{name}, delay" if delay else name,
                "points",
                np.array([float(c.parameters) for c in members]),
                np.array([c.bic - least for c in members]),
                color=k,
                style=k,
                labels=[label(c) for c in members],
            )
        )
    highest = max(c.bic - least for c in selection.candidates)
    return Figure(
        "Orders",
        "Parameters (labels: n, m)",
        [Panel("BIC above the least", series, limits=(-0.6, 1.3 * highest + 1.0))],
        is_whole=True,
    )
