"""What a problem makes of the parameters of its model and criterion, in one table."""

import pytest
from spring_lag_tilt import Spring, spring

import greybox as gb

BIASED = gb.OutputError(biases=("x",))


def test_the_table_has_what_is_free_fixed_tied_and_renamed_by_both_names():
    problem = gb.Problem(
        Spring(),
        spring(),
        BIASED,
        fixed={"c": 0.4},
        tied={"b": lambda p: 0.5 * p.k},
        rename={"k": "stiffness", "x_bias": "offset"},
        bounds={"k": (1.0, 5.0)},
        start={"k": 3.0},
        prior={"k": (2.0, 0.5)},
    )
    table = problem.resolved
    assert set(table.declared) == {*Spring().parameters, "x_bias"}
    assert set(table.untied) == set(table.declared) - {"b"}
    assert table.outside["k"] == "stiffness"
    assert {*table.by_outside_name} >= {"stiffness", "offset", "c"}

    stiffness, c = table.by_outside_name["stiffness"], table.by_outside_name["c"]
    assert (stiffness.bounds, stiffness.start, stiffness.fixed) == ((1.0, 5.0), 3.0, False)
    assert (c.start, c.fixed) == (0.4, True)
    assert [prior.names for prior in table.priors] == [("stiffness",)]

    values = problem.local_values(
        {name: parameter.start for name, parameter in problem.parameters.items()}
    )
    assert values["b"] == pytest.approx(0.5 * 3.0)


def test_what_was_stated_survives_a_change_of_another_option():
    problem = gb.Problem(Spring(), spring(), BIASED, free="k", rename={"k": "stiffness"})
    changed = problem.with_(fixed={"c": 0.4})
    assert changed.parameters["c"].fixed
    assert not problem.parameters["c"].fixed
    assert changed.resolved.outside == problem.resolved.outside
    assert changed.free == ("k",)


def test_a_problem_is_not_changed_after_it_is_made():
    problem = gb.Problem(Spring(), spring())
    for name in ("model", "criterion", "resolved", "has_default_criterion"):
        with pytest.raises(AttributeError):
            setattr(problem, name, None)
