"""One model for several records."""

import pytest
from spring_lag_tilt import HELD, SPRING, Spring, assert_true, fit, spring

import greybox as gb


def test_parameters_of_a_records_own_get_its_number():
    records = [spring(seed=k) for k in range(3)]
    both = gb.several(Spring(), records, own=("b",), criterion=HELD, rename={"k": "stiffness"})
    assert set(both.parameters) == {"stiffness", "c", "d", "b_1", "b_2", "b_3"}
    assert [part.data for part in both.parts] == records
    assert set(gb.several(Spring(), records, own="b").parameters) == {
        "k",
        "c",
        "d",
        "b_1",
        "b_2",
        "b_3",
    }


def test_several_records_find_what_each_has_for_itself():
    records = [spring(seed=1), spring(seed=2, values=SPRING | {"b": 1.5})]
    found = fit(gb.several(Spring(), records, own=("b",), criterion=HELD))
    assert_true(found, {"k": SPRING["k"], "c": SPRING["c"], "b_1": SPRING["b"], "b_2": 1.5})


def test_mistakes_are_sentences():
    with pytest.raises(
        ValueError, match="takes a list of at least two records: for one, use Problem"
    ):
        gb.several(Spring(), [spring()])
    with pytest.raises(ValueError, match="Spring has no parameter 'mass'; it has k, c, b, d"):
        gb.several(Spring(), [spring(seed=1), spring(seed=2)], own=("mass",))
