"""The figure of an order selection: BIC above the least, a color for every number of integrators and delay."""

from types import SimpleNamespace

from matplotlib.colors import to_hex

from greybox.identification.orders import OrderCandidate
from greybox.plotting.orders import orders
from greybox.plotting.style import COLORS, GRAYS, MARKERS


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
    ax = orders(SimpleNamespace(candidates=grid, least=grid[3], chosen=grid[1]))
    plain, delayed, integrating, limit, ring = ax.get_lines()
    places = [line.get_xydata().round(9).tolist() for line in (plain, delayed, integrating, ring)]
    assert places[0] == [[2, 45], [3, 22], [4, 3], [5, 10], [6, 10.1]]
    assert places[1:] == [[[4, 0]], [[3, 1.5]], [[3, 1.5]]]
    looks = [
        (to_hex(line.get_color()).upper(), line.get_marker())
        for line in (plain, delayed, integrating)
    ]
    assert looks == [*zip(COLORS[:3], MARKERS[:3], strict=True)]
    assert (limit.get_ydata()[0], to_hex(limit.get_color())) == (2, GRAYS[0])
    named = {text.get_text(): text.xy for text in ax.texts}
    assert named == {"3, 0": (3, 1.5), "2, 0": (4, 0.0), "3, 1": (5, 10.0)}
    told = [text.get_text() for text in ax.get_legend().get_texts()]
    assert told == ["no integrator", "no integrator, delay", "1 integrator", "chosen"]
    assert -2 < ax.get_ylim()[0] < 0
    assert all(tick == round(tick) for tick in ax.xaxis.get_major_locator().tick_values(2, 6))
    assert (ax.get_xlabel(), ax.get_ylabel()) == (
        "parameters (labels: n, m)",
        "BIC above the least",
    )
