"""One nonlinear model for both operating points of the pitch: what it costs, table by table."""

import numpy as np
import pytest

import greybox as gb
from greybox.models.tilt import Tilt
from greybox.problems import (
    pitch_5deg,
    pitch_hover,
    pitch_operating_points,
    pitch_two_points,
)

pytestmark = pytest.mark.usefixtures("unjudged_file")


@pytest.fixture(scope="module")
def costs():
    return pitch_operating_points.costs(starts=3)


def test_alone_each_table_is_explained_as_by_the_transfer_function(costs):
    """At 5° the drag has the slope a5 of the paper, in hover none: there (4.25) is the same with a5 = 0."""
    hover, moving = (alone for alone, _ in costs.values())
    assert moving == pytest.approx(pitch_5deg.minimum, rel=1e-5)
    undamped = gb.fit(gb.Problem(Tilt(), pitch_hover.data(), fixed={"a5": 0.0}), 2, profiles=False)
    assert hover == pytest.approx(undamped.cost, rel=1e-5)


def test_together_they_cost_what_the_docstring_says(costs):
    alone, jointly = np.array(list(costs.values())).T
    assert jointly.sum() == pytest.approx(pitch_operating_points.minimum, rel=1e-5)
    for value in (f"{alone.sum():.3f}", *(f"{cost:.3f}" for cost in (*jointly, jointly.sum()))):
        assert value in pitch_operating_points.__doc__
    assert round(jointly.sum() / alone.sum()) == 5
    assert alone.sum() < pitch_two_points.minimum < jointly.sum()


def test_the_comparison_prints_both_tables(costs, monkeypatch):
    monkeypatch.setattr(pitch_operating_points, "costs", lambda starts: dict(costs))
    text = pitch_operating_points.comparison()
    assert [line.split()[-1] for line in text.splitlines()[-3:]] == ["8.5", "2.1", "5.0"]


def test_a_free_drag_goes_to_its_lower_bound():
    parts = [part.with_(fixed={}) for part in pitch_operating_points.tables()]
    fit = gb.fit(parts[0] + parts[1], 2, progress=False)
    assert f"{fit.cost:.3f}" in pitch_operating_points.__doc__
    assert [q.name for q in fit.quantities if q.at_bound] == ["C_x"]
