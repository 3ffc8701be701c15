"""Parameters: what they keep and every value that they refuse."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_allclose

import greybox as gb


def test_defaults():
    parameter = gb.Parameter(2.0)
    assert parameter.bounds == parameter.box == (-math.inf, math.inf)
    assert (parameter.unit, parameter.about, parameter.fixed, parameter.scale) == (
        "1",
        "",
        False,
        "linear",
    )


def test_starts_are_drawn_in_the_bounds_unless_said():
    assert gb.Parameter(2.0, bounds=(0, 5)).box == (0, 5)
    assert gb.Parameter(2.0, bounds=(0, 5), starts=(1, 4)).box == (1, 4)
    assert gb.Parameter(2.0, bounds=(0, 5), starts=(3, 3)).box == (3, 3)


@pytest.mark.parametrize("wrong", [{"unit": 3}, {"about": None}, {"fixed": "yes"}, {"fixed": 1}])
def test_texts_and_flags_of_another_type_are_refused_by_their_name(wrong):
    (name,) = wrong
    with pytest.raises(TypeError, match=f"^{name} is "):
        gb.Parameter(1.0, **wrong)
    assert gb.Parameter(1.0, fixed=np.True_).fixed


@pytest.mark.parametrize("start", [0.0, 5.0])
def test_a_start_may_lie_on_a_bound(start):
    assert gb.Parameter(start, bounds=(0, 5)).start == start


def test_a_parameter_is_frozen_and_compares_by_value():
    parameter = gb.Parameter(2.0, bounds=(0, 5))
    with pytest.raises(dataclasses.FrozenInstanceError):
        parameter.start = 3.0
    assert parameter == gb.Parameter(2.0, bounds=(0, 5))
    assert parameter != gb.Parameter(2.0, bounds=(0, 6))


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ({"start": math.nan}, r"start nan is not a finite number: give a value inside bounds"),
        ({"start": math.inf}, r"start inf is not a finite number"),
        ({"start": "2"}, r"start '2' is not a"),
        ({"start": None}, r"start None is not a"),
        ({"start": 6.0}, r"start 6 lies outside bounds \(0, 5\): move the start or widen them"),
        ({"start": -0.1}, r"start -0\.1 lies outside bounds"),
        (
            {"bounds": (5, 0)},
            r"bounds \(5, 0\) are reversed or empty: give \(low, high\) with low < high",
        ),
        ({"bounds": (2, 2)}, r"bounds \(2, 2\) are reversed or empty"),
        ({"bounds": (math.nan, 5)}, r"bounds \(nan, 5\) contain a NaN"),
        ({"bounds": 5}, r"bounds 5 must be a pair of numbers"),
        ({"bounds": (0, 1, 5)}, r"bounds \(0, 1, 5\) must be a pair"),
        ({"bounds": ("a", "b")}, r"bounds \('a', 'b'\) must be a pair"),
        ({"bounds": None}, r"bounds None must be a pair"),
        (
            {"starts": (3, 1)},
            r"starts \(3, 1\) must be two finite numbers \(low, high\) with low <= high",
        ),
        ({"starts": (0, math.inf)}, r"starts \(0, inf\) must be two finite numbers"),
        (
            {"starts": (-1, 4)},
            r"starts \(-1, 4\) reach outside bounds \(0, 5\): narrow the start box or widen",
        ),
        ({"starts": (1, 6)}, r"starts \(1, 6\) reach outside bounds \(0, 5\)"),
        ({"starts": 3}, r"starts 3 must be a pair"),
        (
            {"prior": (1, 0)},
            r"prior \(1, 0\) must be two finite numbers",
        ),
        ({"prior": (1, -2)}, r"prior \(1, -2\) must be"),
        ({"prior": (1, math.inf)}, r"prior \(1, inf\) must be"),
        ({"prior": (math.inf, 1)}, r"prior \(inf, 1\) must be"),
        ({"prior": 3}, r"prior 3 must be a pair"),
        ({"scale": "ln"}, r"scale 'ln' is not known: use 'linear' or 'log'"),
        (
            {"scale": "log"},
            r"scale 'log' needs positive bounds, not \(0, 5\): raise the lower bound above 0",
        ),
    ],
)
def test_bad_values_are_refused(words, sentence):
    with pytest.raises(ValueError, match=sentence):
        gb.Parameter(**{"start": 2.0, "bounds": (0, 5)} | words)


def test_a_share_of_the_box_is_even_on_the_scale():
    shares = np.array([0.0, 0.5, 1.0])
    assert_allclose(gb.Parameter(2.0, bounds=(0, 5), starts=(1, 4)).in_box(shares), [1, 2.5, 4])
    assert_allclose(
        gb.Parameter(2.0, bounds=(0.01, 100), scale="log").in_box(shares), [0.01, 1, 100]
    )


@given(seed=st.integers(0, 100), scale=st.sampled_from(["linear", "log"]))
def test_draws_are_those_of_numpy_and_lie_in_the_box(seed, scale):
    drawn = gb.Parameter(2.0, bounds=(0.1, 50), starts=(1, 4), scale=scale).draw(
        np.random.default_rng(seed)
    )
    random = np.random.default_rng(seed)
    wanted = random.uniform(1, 4) if scale == "linear" else math.exp(random.uniform(0, math.log(4)))
    assert drawn == pytest.approx(wanted, rel=1e-14)
    assert 1 <= drawn <= 4


@pytest.mark.parametrize(
    ("parameter", "box"),
    [
        (gb.Parameter(2.0), (-18, 22)),
        (gb.Parameter(0.0, bounds=(-math.inf, 1)), (-10, 1)),
        (gb.Parameter(-300.0, bounds=(-400, math.inf)), (-400, 2700)),
        (gb.Parameter(5.0, bounds=(0, math.inf), starts=(20, 30)), (20, 30)),
        (gb.Parameter(0.5, bounds=(0.1, math.inf), scale="log"), (0.1, 10.5)),
    ],
)
def test_an_open_end_is_closed_ten_sizes_of_the_start_away(parameter, box):
    random = np.random.default_rng(0)
    drawn = [parameter.draw(random) for _ in range(400)]
    assert box[0] <= min(drawn) < max(drawn) <= box[1]
    assert max(drawn) > box[1] - 0.1 * (box[1] - box[0])
