"""Biases in a sum of problems: each record has its own, unless they are given one name."""

import numpy as np
import pytest
from spring_lag_tilt import HELD, SPRING, Spring, assert_true, fit_finely as fit, spring

import greybox as gb
from greybox.modeling.formulation.sum import numbered_parts

pytestmark = pytest.mark.usefixtures("unjudged_file")

BIASED = gb.OutputError(inputs="held", biases=("x",))


def biased(seed, offset, **options):
    data = spring(seed=seed, **options)
    return data.with_signals(x=data["x"] + offset)


def renames(*problems):
    return [dict(part.rename) for part in numbered_parts(problems)]


def test_numbers_are_given_only_where_records_share_a_name():
    a, b = (gb.Problem(Spring(), biased(k, 0.0), BIASED) for k in range(2))
    bare = gb.Problem(Spring(), spring(seed=2), HELD)
    assert renames(a) == renames(a, a)[:1] == [{}]
    assert renames(a, bare) == [{}, {}]
    assert renames(a, b) == [{"x_bias": "x_bias_1"}, {"x_bias": "x_bias_2"}]
    assert renames(bare, a, b) == [{}, {"x_bias": "x_bias_2"}, {"x_bias": "x_bias_3"}]
    taken = b.with_(rename={"k": "x_bias_1"})
    assert renames(a, taken)[0] == {"x_bias": "x_bias_2"}


def test_stretches_of_one_log_are_different_records():
    whole = biased(0, 0.0)
    halves = [
        gb.Problem(Spring(), whole.rows(rows), BIASED)
        for rows in (np.arange(150), np.arange(150, 300))
    ]
    assert renames(*halves) == [{"x_bias": "x_bias_1"}, {"x_bias": "x_bias_2"}]


def test_a_record_biases_are_its_own_when_renamed():
    a, b = spring(seed=1), spring(seed=2)
    b = b.with_signals(x=b["x"] + 0.5)
    problem = gb.Problem(Spring(), a, BIASED) + gb.Problem(
        Spring(), b, BIASED, rename={"x_bias": "x_bias_2"}
    )
    assert_true(fit(problem), SPRING | {"x_bias": 0.0, "x_bias_2": 0.5})


def test_in_a_plain_sum_every_record_has_a_bias_of_its_own():
    problems = [
        gb.Problem(Spring(), biased(k, offset), BIASED) for k, offset in enumerate((0.4, -0.3, 0.1))
    ]
    truth = SPRING | {"x_bias_1": 0.4, "x_bias_2": -0.3, "x_bias_3": 0.1}
    for problem in (
        sum(problems),
        problems[0] + (problems[1] + problems[2]),
        sum(problems).with_(weight=1.0),
    ):
        assert set(problem.parameters) == {*truth, "d"}
    found = fit(sum(problems))
    assert_true(found, truth)
    assert (
        fit(gb.several(Spring(), [p.data for p in problems], criterion=BIASED)).estimate
        == found.estimate
    )


def test_a_bias_is_shared_where_the_parts_give_it_one_name_or_are_of_one_record():
    a, b = biased(1, 0.4), biased(2, 0.4)
    shared = {"rename": {"x_bias": "x_bias"}}
    together = gb.Problem(Spring(), a, BIASED, **shared) + gb.Problem(Spring(), b, BIASED, **shared)
    apart = gb.Problem(Spring(), a, BIASED) + gb.Problem(Spring(), b, BIASED)
    found, wide = fit(together), fit(apart)
    assert_true(found, SPRING | {"x_bias": 0.4})
    # Half the variance, for errors that are taken as white; that they are is estimated record by
    # record.
    both = found.white[found.free.index("x_bias"), found.free.index("x_bias")]
    own = wide.white[wide.free.index("x_bias_1"), wide.free.index("x_bias_1")]
    assert both < 0.85**2 * own
    assert set(gb.several(Spring(), [a, b], criterion=BIASED, **shared).parameters) == {
        *SPRING,
        "d",
        "x_bias",
    }
    again = gb.Problem(Spring(), a, BIASED) + gb.Problem(
        Spring(), gb.Record(a.time, a.signals, a.units), BIASED
    )
    assert set(again.parameters) == {*SPRING, "d", "x_bias"}


def test_numbers_of_biases_are_those_of_the_records_and_take_no_name_that_is_there():
    a, b, c = (biased(k, 0.0) for k in range(3))
    without = (
        gb.Problem(Spring(), a, HELD)
        + gb.Problem(Spring(), b, BIASED)
        + gb.Problem(Spring(), c, BIASED)
    )
    assert [n for n in without.parameters if "bias" in n] == ["x_bias_2", "x_bias_3"]
    named = gb.Problem(Spring(), a, BIASED, rename={"x_bias": "x_bias_2"})
    three = named + gb.Problem(Spring(), b, BIASED) + gb.Problem(Spring(), c, BIASED)
    assert len({n for n in three.parameters if "bias" in n}) == 3
    fixed = gb.Problem(Spring(), a, BIASED, fixed={"x_bias": 0.2}) + gb.Problem(Spring(), b, BIASED)
    assert fixed.parameters["x_bias_1"].fixed
    assert not fixed.parameters["x_bias_2"].fixed


def test_a_bias_of_an_earlier_fit_keeps_the_name_that_the_fit_knows():
    a, b = biased(1, 0.4), biased(2, -0.2)
    earlier = fit(gb.Problem(Spring(), a, BIASED))
    held = gb.Problem(Spring(), a, BIASED, fixed={"x_bias": earlier})
    found = fit(
        held + gb.Problem(Spring(), b, BIASED) + gb.Problem(Spring(), biased(3, 0.1), BIASED)
    )
    assert found.estimate["x_bias"] == earlier.estimate["x_bias"]
    assert found.standard_error["x_bias"] == pytest.approx(earlier.standard_error["x_bias"])
    assert_true(found, {"x_bias_2": -0.2, "x_bias_3": 0.1})
