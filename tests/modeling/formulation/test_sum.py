"""Problems add, in any order and grouping."""

import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured

import greybox as gb

DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, name="two")
A, B, C = (gb.Problem(Lag(), DATA, name=name, rename={"T": f"T_{name}"}) for name in "abc")


def test_sums_of_sums_are_one_list_of_parts():
    for total in (A + B + C, A + (B + C), (A + B) + C, sum([A, B, C]), sum([A + B, C])):
        assert total.parts == (A, B, C)
        assert total.name == "a + b + c"
        assert list(total.parameters) == ["K", "T_a", "T_b", "T_c"]
    assert sum([A]) is A
    both = A + B
    assert sum([both]) is both


def test_the_name_of_many_is_short():
    total = sum(gb.Problem(Lag(), DATA, name=f"flight {k}") for k in range(100))
    assert total.name == "flight 0 + flight 1 + ... + flight 99 (100 in all)"


def test_only_problems_add():
    for wrong in (1, "b", None, [B]):
        for first, second in ((A, wrong), (A + B, wrong), (wrong, A), (wrong, A + B)):
            with pytest.raises(TypeError):
                first + second


def test_changes_reach_every_part():
    changed = (A + B).with_(delay="pade:2", name="both")
    assert [part.delay for part in changed.parts] == ["pade:2", "pade:2"]
    assert changed.name == "both"
    assert changed.as_added == changed.parts


def test_ties_of_one_name_must_agree():
    def tied(function, name):
        return gb.Problem(LagLagDelay(), DATA, name=name, tied={"T2": function})

    agreeing = tied(lambda p: p.T1 / 2, "a") + tied(lambda p: 0.5 * p.T1, "b")
    assert "T2" not in agreeing.parameters
    with pytest.raises(
        ValueError, match="'T2' is tied in 'b' and free or tied differently in another part"
    ):
        tied(lambda p: p.T1 / 2, "a") + tied(lambda p: p.T1 / 3, "b")
    with pytest.raises(
        ValueError, match="tied in 'a' and free or tied differently in another part"
    ):
        tied(lambda p: p.T1 / 2, "a") + gb.Problem(LagLagDelay(), DATA)
