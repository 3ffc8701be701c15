"""Where the runs begin: the sequences, the boxes, listed points, and what is refused."""

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import qmc

import greybox as gb
from greybox.modeling.formulation.starts import as_starts

BOXES = {
    "a": gb.Parameter(0.0, bounds=(-3, 5)),
    "b": gb.Parameter(1.0, bounds=(-10, 10), starts=(1, 2)),
    "c": gb.Parameter(1.0, bounds=(1e-4, 1e4), scale="log"),
}
RULES = [gb.solve.Sobol]
DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS)


@pytest.mark.parametrize("rule", RULES)
def test_points_fill_the_start_boxes_evenly_in_the_parameters_own_scale(rule):
    points = rule(512, seed=3).draw(BOXES)
    assert points.shape == (512, 3)
    for values, (low, high) in zip(
        (points[:, 0], points[:, 1], np.log10(points[:, 2])),
        ((-3, 5), (1, 2), (-4, 4)),
        strict=True,
    ):
        assert values.min() >= low
        assert values.max() <= high
        counts, _ = np.histogram(values, 8, (low, high))
        assert_allclose(counts, 64, atol=32)  # four standard deviations of a binomial count


@pytest.mark.parametrize("n", [1, 3, 8, 100])
def test_more_sobol_points_begin_with_the_same_points(n):
    assert_array_equal(
        gb.solve.Sobol(2 * n, seed=4).draw(BOXES)[:n], gb.solve.Sobol(n, seed=4).draw(BOXES)
    )


@pytest.mark.parametrize("rule", RULES)
def test_the_seed_decides_the_points(rule):
    assert_array_equal(rule(20, seed=1).draw(BOXES), rule(20, seed=1).draw(BOXES))
    assert not np.any(rule(20, seed=1).draw(BOXES) == rule(20, seed=2).draw(BOXES))


def test_listed_points_keep_the_declared_start_where_they_are_silent():
    points = gb.solve.Listed([{}, {"a": 4.0}]).draw(BOXES)
    assert_array_equal(points, [[0, 1, 1], [4, 1, 1]])


def test_a_listed_point_outside_its_bounds_is_refused():
    with pytest.raises(
        ValueError,
        match=r"gives 'a' the value 99, outside its bounds \(-?\d+, 5\): move the start or widen",
    ):
        gb.solve.Listed([{"a": 99.0}]).draw(BOXES)


def test_a_rule_has_its_own_seed_and_says_so():
    assert (
        str(as_starts([{"a": 2.0}, gb.solve.Sobol(3, seed=9)])) == "1 listed + 3 by Sobol, seed 9"
    )
    assert as_starts([{"a": 2.0}, gb.solve.Sobol(3, seed=9)]).seed == 9
    with pytest.raises(
        ValueError, match=r"seed = 4 goes with a number of starts: give it to the rule"
    ):
        as_starts(gb.solve.Sobol(3, seed=9), seed=4)


def test_a_list_mixes_points_and_rules_in_its_order():
    points = as_starts([{"a": 2.0}, gb.solve.Sobol(3, seed=9), {}]).draw(BOXES)
    assert_array_equal(points[0], [2, 1, 1])
    assert_array_equal(points[1:4], gb.solve.Sobol(3, seed=9).draw(BOXES))
    assert_array_equal(points[4], [0, 1, 1])


def test_a_number_means_the_declared_values_and_sobol_points_and_the_runs_begin_there():
    parameters = LagLagDelay().parameters
    fit = gb.fit(gb.Problem(LagLagDelay(), DATA), starts=6, seed=11)
    expected = gb.solve.Sobol(5, seed=11).draw(parameters)
    assert_array_equal(fit.runs[0].start, [p.start for p in parameters.values()])
    assert_array_equal([run.start for run in fit.runs[1:]], expected)
    assert "the declared values + 5 by Sobol, seed 11" in fit.details
    assert as_starts(1, 3) == gb.solve.Listed(({},))


def test_an_infinite_box_is_refused_and_a_start_box_or_a_list_cures_it():
    class Open(gb.TransferFunction):
        K = gb.Parameter(1.0, bounds=(0, np.inf))

        def response(self, s, p):
            return p.K / (s + 1)

    class Boxed(Open):
        K = gb.Parameter(1.0, bounds=(0, np.inf), starts=(1, 10))

    data = measured(Open(), TWO_LAGS_OMEGA, {"K": 7.0})
    with pytest.raises(
        ValueError,
        match=r"random starts for 'K' need finite bounds.*\(0, inf\).*start box",
    ):
        gb.fit(gb.Problem(Open(), data), starts=3)
    for problem, starts in ((gb.Problem(Open(), data), [{}]), (gb.Problem(Boxed(), data), 3)):
        assert gb.fit(problem, starts=starts).estimate["K"] == pytest.approx(7, rel=1e-6)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0,), "number of starts is 0: give a whole number of at least 1"),
        ((-3,), "number of starts is -3"),
        ((2.5,), r"number of starts is 2\.5"),
        ((True,), "number of starts is True"),
        (("9",), "number of starts is '9'"),
        ((5, -1), "seed of starts is -1: give a whole number of at least 0"),
        ((5, 1.5), r"seed of starts is 1\.5"),
        ((5, None), "seed of starts is None"),
    ],
)
def test_bad_number_or_seed_is_refused(rule, arguments, words):
    with pytest.raises(ValueError, match=words):
        rule(*arguments)


@pytest.mark.parametrize(
    ("starts", "kind", "words"),
    [
        (0, ValueError, "number of starts is 0"),
        (
            [{"K": 1.0}, {"gain": 1.0}],
            ValueError,
            "names 'gain', which is not free; free are K, T1, T2, tau",
        ),
        ([{"K": float("nan")}], ValueError, "gives 'K' the value nan: give a finite number"),
        ([{"K": "big"}], ValueError, "gives 'K' the value 'big': give a finite number"),
        (gb.solve.Listed([]), ValueError, "list of starts is empty"),
        ([], TypeError, r"starts is \[\]: give a number, a rule such as"),
        ("200", TypeError, "starts is '200': give a number"),
        (True, TypeError, "starts is True: give a number"),
        (2.5, TypeError, r"starts is 2\.5: give a number"),
        ([3], TypeError, r"starts is \[3\]: give a number"),
    ],
)
def test_starts_that_are_none_are_refused_in_a_sentence(starts, kind, words):
    with pytest.raises(kind, match=words):
        gb.fit(gb.Problem(LagLagDelay(), DATA), starts=starts)


def test_a_fixed_parameter_has_no_start():
    with pytest.raises(ValueError, match="names 'tau', which is not free; free are K, T1, T2"):
        gb.fit(gb.Problem(LagLagDelay(), DATA, fixed={"tau": 0.05}), starts=[{"tau": 0.1}])


@pytest.mark.parametrize("rule", RULES)
def test_the_seed_is_zero_unless_it_is_given(rule):
    assert_array_equal(rule(8).draw(BOXES), rule(8, seed=0).draw(BOXES))


def test_a_number_of_starts_is_the_declared_one_and_the_sequence_of_scipy():
    rule = as_starts(9001, 3)
    unit = qmc.Sobol(3, scramble=True, rng=np.random.default_rng(3)).random_base2(14)[:9000]
    columns = [p.in_box(unit[:, k]) for k, p in enumerate(BOXES.values())]
    expected = np.vstack([[p.start for p in BOXES.values()], np.column_stack(columns)])
    assert_array_equal(rule.draw(BOXES), expected)


def test_starts_that_would_fill_the_memory_are_refused():
    for rule in (as_starts(10**12), as_starts(1e12), gb.solve.Sobol(10**9)):
        with pytest.raises(
            ValueError, match=r"(99999|0000) Sobol points are too many: give at most 1048576"
        ):
            rule.draw(BOXES)
