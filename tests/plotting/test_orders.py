"""The figure of an order selection: BIC above the least, a color for every number of integrators and delay."""

from types import SimpleNamespace

import numpy as np
from drawn_lines import legend

from greybox.identification.orders import OrderCandidate
from greybox.plotting.orders import orders, orders_figure


def test_structures_stand_at_their_parameters_and_the_best_of_each_number_is_named_where_it_is_near():
    grid = [  # n, m, integrators, delay; by number of parameters and BIC; the least is not the one chosen
        OrderCandidate(1, 0, 0, False, None, 75.0),
        OrderCandidate(3, 0, 1, False, None, 31.5),
        OrderCandidate(2, 0, 0, False, None, 52.0),
        OrderCandidate(2, 0, 0, True, None, 30.0),
        OrderCandidate(2, 1, 0, False, None, 33.0),
        OrderCandidate(3, 1, 0, False, None, 40.0),
        OrderCandidate(3, 2, 0, False, None, 40.1),
    ]
    selection = SimpleNamespace(candidates=grid, least=grid[3], chosen=grid[1])
    (panel,) = orders_figure(selection).panels
    limit, plain, delayed, integrating = panel.series
    places = [
        np.column_stack([series.x, series.y]).round(9).tolist()
        for series in (plain, delayed, integrating)
    ]
    assert places[0] == [[2, 45], [3, 22], [4, 3], [5, 10], [6, 10.1]]
    assert places[1:] == [[[4, 0]], [[3, 1.5]]]
    assert [(s.color, s.style) for s in (plain, delayed, integrating)] == [(0, 0), (1, 1), (2, 2)]
    assert limit.y[0] == 2
    labels = {
        text: x
        for s in (plain, delayed, integrating)
        for text, x in zip(s.labels, s.x, strict=True)
        if text
    }
    assert labels == {"3, 0: chosen": 3, "2, 0": 4, "3, 1": 5}
    ax = orders(selection)
    assert legend(ax) == ["no integrator", "no integrator, delay", "1 integrator"]
    assert ax.get_yscale() == "symlog"
    assert -2 < ax.get_ylim()[0] < 0
