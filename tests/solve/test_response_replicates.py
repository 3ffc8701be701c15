"""How data of replicates are drawn, by what chance says of the draws."""

import numpy as np
import pytest

from greybox.solve.response_replicates import ResponseDraws


def draws(drawn, *, parts=1, points=3, unknowns=4):
    """Draws of parts of so many points each, without noise; frequencies 1, 2, ... tell the points apart."""
    tables = tuple(np.array([1.0 + np.arange(points), np.ones(points), np.zeros(points)]) for _ in range(parts))
    shape = {"responses": (np.ones(points, complex),) * parts, "errors": (np.zeros(points, complex),) * parts}
    sizes, deviations, unknown = (np.ones(points),) * parts, (0.0,) * parts, (None,) * parts
    none = {"constants": np.zeros(0), "root": np.zeros((0, 0))}
    return ResponseDraws(
        drawn,
        0,
        tables,
        sizes=sizes,
        deviations=deviations,
        dofs=unknown,
        common=unknown,
        unknowns=unknowns,
        **shape,
        **none,
    )


def test_points_that_are_too_few_distinct_ones_are_no_replicate():
    """Three draws of three points: all of them are different in 6 of 27 cases, and four unknowns need more than two."""
    found = [draws("points").replicate(number) for number in range(400)]
    kept = [values[1:4] for values in found if values is not None]
    assert all(sorted(frequencies) == [1, 2, 3] for frequencies in kept)
    assert len(kept) / 400 == pytest.approx(6 / 27, abs=0.07)
    assert all(draws("points", unknowns=1).replicate(number) is not None for number in range(50))


def test_parts_are_drawn_as_often_as_there_are_parts():
    counts = np.array([draws("parts", parts=4).replicate(number)[:4] for number in range(200)])
    assert np.all(counts.sum(axis=1) == 4)
    assert np.var(counts) == pytest.approx(4 * 1 / 4 * 3 / 4, abs=0.15)  # binomial


def test_one_observation_is_left_out():
    part, values = draws("points", parts=2).without(4)
    assert part == 1
    assert values[2 : 2 + 9].reshape(3, 3)[0].tolist() == [1, 2, 3]
    assert values[2 + 9 :].reshape(3, 2)[0].tolist() == [1, 3]
    part, values = draws("parts", parts=3).without(1)
    assert (part, values[:3].tolist()) == (None, [1, 0, 1])
    with pytest.raises(IndexError):
        draws("points").without(3)
