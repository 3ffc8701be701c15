"""Statements of problems: fixed, free, tied, constrained and renamed parameters, sums, and every refusal."""

import inspect
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from declared_models import (
    ROTOR,
    ROTOR_OMEGA,
    TILT,
    TILT_OMEGA,
    TWO_LAGS,
    TWO_LAGS_OMEGA,
    Lag,
    LagLagDelay,
    measured,
)

import greybox as gb
from greybox.models.rotor import Rotor
from greybox.models.tilt import LinearTilt, Tilt

pytestmark = pytest.mark.usefixtures("unjudged_file")

SHARED = TILT | {"T_rotor": ROTOR["T_rotor"], "T_delay": ROTOR["T_delay"]}
DATA = measured(Tilt(), TILT_OMEGA, SHARED)
TWO = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS)
SPEED = measured(Rotor(), ROTOR_OMEGA, ROTOR)


def fit(problem, starts=5):
    return gb.fit(problem, starts=starts, profiles=False, progress=False)


def assert_truth(found, truth, rel=1e-6):
    assert {n: found.estimate[n] for n in truth} == pytest.approx(truth, rel=rel)


# --- fixed and free


def test_a_fixed_value_is_kept_and_the_rest_follows():
    found = fit(gb.Problem(LagLagDelay(), TWO, fixed={"tau": 0.05, "T1": 1.0}))
    assert found.free == ("K", "T2")
    assert_truth(found, TWO_LAGS)


def test_a_wrong_fixed_value_is_kept_too():
    assert fit(gb.Problem(LagLagDelay(), TWO, fixed={"K": 3.0})).estimate["K"] == 3.0


def test_what_a_model_fixes_can_be_freed():
    found = fit(gb.Problem(Tilt(), DATA, free=("T_rotor", "T_delay")))
    assert found.free == ("a1", "a2", "a3", "a4", "T_rotor", "T_delay")
    assert found.cost < 1e-10
    # The rotor's lag may change places with a pole of the airframe.
    placed = gb.Problem(Tilt(), DATA, free=("T_delay",), fixed={"T_rotor": SHARED["T_rotor"]})
    assert_truth(fit(placed), SHARED)
    assert gb.Problem(Tilt(), DATA, free="a5").parameters["a5"].fixed is False


def test_a_fit_gives_its_values_whole_or_by_name():
    rotor = fit(gb.Problem(Rotor(), SPEED))
    for fixed in (rotor, {"T_rotor": rotor, "T_delay": rotor}):
        found = fit(gb.Problem(Tilt(), DATA, fixed=fixed))
        assert found.free == ("a1", "a2", "a3", "a4")
        assert_truth(found, SHARED)


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        (
            {"fixed": {"b": 1.0}},
            "fixed: LagLagDelay has no parameter 'b'; it has K, T1, T2, tau",
        ),
        ({"free": ("b",)}, "free: LagLagDelay has no parameter 'b'"),
        ({"tied": {"b": lambda p: p.K}}, "tied: LagLagDelay has no parameter 'b'"),
        ({"rename": {"b": "c"}}, "rename: LagLagDelay has no parameter 'b'"),
        ({"fixed": {"K": np.nan}}, "fixed gives 'K' the value nan: give a finite number or a Fit"),
        ({"fixed": {"K": "two"}}, "fixed gives 'K' the value 'two'"),
        ({"fixed": {"K": 1e3}}, r"fixed gives 'K' the value 1000 outside its bounds \(0, 100\)"),
        ({"fixed": {"K": 1.0}, "free": ("K",)}, "'K' is both fixed and free"),
        ({"fixed": {"K": 1.0}, "tied": {"K": lambda p: p.T1}}, "'K' is both fixed and tied"),
        ({"free": ("K",), "tied": {"K": lambda p: p.T1}}, "'K' is both free and tied"),
        ({"tied": {"T1": lambda p: p.T3}}, r"tied\['T1'\].*has no 'T3'; it has K, T2, tau"),
        ({"tied": {"T1": lambda p: p["T3"]}}, r"tied\['T1'\].*'T3'"),
        ({"tied": {"T1": lambda p: p.T1}}, r"tied\['T1'\].*has no 'T1'"),
        ({"tied": {"T1": lambda p: None}}, r"tied\['T1'\] gives None: it must give an expression"),
        ({"tied": {"T1": lambda p: np.nan}}, r"tied\['T1'\] is nan at the start values"),
        (
            {"tied": {"T1": lambda p: np.log(p.T2 - 5) if p.T2 > 5 else -np.inf}},
            r"tied\['T1'\] is -inf at the start",
        ),
        (
            {"constraints": [lambda p: p.T1, lambda p: p.T3]},
            r"constraints\[1\].*has no 'T3'; it has K, T1, T2, tau",
        ),
        ({"constraints": [lambda p: None]}, r"constraints\[0\] gives None"),
        (
            {"constraints": [lambda p: p.T1 * np.nan]},
            r"constraints\[0\] is nan at the start values",
        ),
        (
            {"rename": {"T1": "T2"}},
            "rename gives two parameters of LagLagDelay the name 'T2': use tied",
        ),
        ({"delay": "pade"}, r"delay 'pade' is not known: use 'exact' or 'pade:n'"),
        ({"delay": "pade:0"}, "delay 'pade:0' is not known"),
        ({"delay": 3}, "delay 3 is not known"),
        ({"weight": 0.0}, r"weight 0\.0 must be a finite number above 0"),
        ({"weight": -1.0}, r"weight -1\.0 must be"),
        ({"weight": np.inf}, "weight inf must be"),
        (
            {"at": {"theta": 0.1}},
            r"LagLagDelay is a transfer function and has no operating point: leave out at=\{'theta': 0.1\}",
        ),
    ],
)
def test_a_statement_that_does_not_fit_together_is_refused(statement, words):
    with pytest.raises(ValueError, match=words):
        gb.Problem(LagLagDelay(), TWO, **statement)


def test_a_constraint_that_is_a_truth_value_is_refused():
    with pytest.raises(
        ValueError, match=r"constraints\[0\]"
    ):  # as an expression it would be 0 or 1, always >= 0
        gb.Problem(LagLagDelay(), TWO, constraints=[lambda p: p.T1 > p.T2])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            (LagLagDelay, TWO),
            r"model is .*LagLagDelay.*give an instance such as Tilt\(\), not the class",
        ),
        ((TWO, LagLagDelay()), "give a model, then the data"),
        ((LagLagDelay(), pd.DataFrame({"u": [1.0]})), "gb.Record.from_pandas"),
        ((LagLagDelay(), ([1.0], [2.0])), "gb.Record"),
        ((LagLagDelay(), 5), "data is 5: give a FrequencyResponse"),
        ((LagLagDelay(), 5j), "gb.interop.from_control"),
        (
            (LagLagDelay(), TWO, gb.RelativeError),
            "criterion is .*give a criterion such as RelativeError",
        ),
    ],
)
def test_things_of_another_kind_are_refused(arguments, words):
    with pytest.raises(TypeError, match=words):
        gb.Problem(*arguments)
    with pytest.raises(TypeError, match=r"problem is .*give a Problem"):
        gb.fit(LagLagDelay())


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ({"tied": {"T1": 3.0}}, r"tied\['T1'\]"),
        ({"tied": {"T1": lambda p: p.T2 / 0}}, r"tied\['T1'\]"),
        ({"constraints": [3]}, r"constraints\[0\]"),
        ({"constraints": [lambda p: "T1 > T2"]}, r"constraints\[0\]"),
        ({"constraints": lambda p: p.T1 - p.T2}, "constraints"),
        ({"fixed": ("K",)}, "fixed"),
        ({"weight": "heavy"}, "weight 'heavy' must be a finite number"),
    ],
    ids=["number", "zero division", "number as constraint", "text", "no list", "tuple", "weight"],
)
def test_other_kinds_of_statements_are_refused_by_their_name(statement, words):
    with pytest.raises((ValueError, TypeError), match=words):
        gb.Problem(LagLagDelay(), TWO, **statement)


@pytest.mark.parametrize("new", ["", 3])
def test_a_new_name_is_a_string(new):
    with pytest.raises(TypeError, match=f"^rename gives 'T1' the name {new!r}: give a string.$"):
        gb.Problem(LagLagDelay(), TWO, rename={"T1": new})


def test_a_model_must_not_declare_what_its_criterion_adds():
    class Biased(gb.StateSpace):
        inputs, outputs = ("u",), ("y",)
        y_bias = gb.Parameter(0.0)

        def output(self, x, u, p):
            return (u.u + p.y_bias,)

    record = gb.Record([0.0, 1.0, 2.0], {"u": [0.0, 1.0, 3.0], "y": [0.1, 1.2, np.nan]})
    with pytest.raises(
        ValueError,
        match=r"^Biased declares 'y_bias', which is also a parameter of the cri",
    ):
        gb.Problem(Biased(), record, gb.OutputError(biases=("y",)))


def test_data_and_model_meet_by_signal_names():
    with pytest.raises(ValueError, match="Rotor has no output 'theta'; it has Omega"):
        gb.Problem(Rotor(), DATA)
    with pytest.raises(ValueError, match=r"LinearTilt has several outputs \(theta, v\)"):
        gb.Problem(LinearTilt(), gb.FrequencyResponse(TILT_OMEGA, DATA.response))
    with pytest.raises(ValueError, match="LinearTilt has no state or input 'phi'"):
        gb.Problem(LinearTilt(), DATA, at={"phi": 0.0})
    assert_truth(
        fit(gb.Problem(LinearTilt(), DATA, fixed={n: ROTOR[n] for n in ("T_rotor", "T_delay")})),
        TILT,
    )


# --- tied and constrained


def test_a_tied_parameter_follows_the_others():
    found = fit(gb.Problem(LagLagDelay(), TWO, tied={"T1": lambda p: 10 * p.T2}))
    assert found.free == ("K", "T2", "tau")
    assert_truth(found, TWO_LAGS)
    assert found.estimate["T1"] == pytest.approx(10 * found.estimate["T2"], rel=1e-14)
    assert found.standard_error["T1"] == pytest.approx(10 * found.standard_error["T2"], rel=1e-9)


def test_a_tied_parameter_stays_inside_its_bounds_or_is_told():
    # The tie alone would end at T2 < 0, an unstable lag, where the declared lower bound is 0.001 s.
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS | {"T2": 0.0011}, noise=0.02)
    found = fit(gb.Problem(LagLagDelay(), data, tied={"T2": lambda p: 0.5 - p.T1}))
    assert found.estimate["T2"] >= 0.001 - 1e-9 or any("T2" in text for text in found.warnings)


def test_ties_may_refer_to_earlier_ties():
    ties = {"T1": lambda p: 10 * p.T2, "tau": lambda p: p.T1 / 20}
    assert_truth(fit(gb.Problem(LagLagDelay(), TWO, tied=ties)), TWO_LAGS)


def test_an_ordering_of_two_lags_leaves_one_variant():
    free = fit(gb.Problem(LagLagDelay(), TWO), starts=12)
    ordered = fit(gb.Problem(LagLagDelay(), TWO, constraints=[lambda p: p.T1 - p.T2]), starts=12)
    assert len(free.minima) == len(ordered.minima) == 1
    assert (free.minima[0].variants, ordered.minima[0].variants) == (2, 1)
    assert_truth(ordered, TWO_LAGS)


@pytest.mark.parametrize("lag", [0.05, 0.1, 0.4])
def test_equal_lags_are_no_minimum(lag):
    # From equal lags, no slope leads to unequal ones.
    equal = {"K": 1.0, "T1": lag, "T2": lag, "tau": 0.01}
    found = fit(gb.Problem(LagLagDelay(), TWO), starts=[equal, equal | {"K": 2.0}])
    assert len(found.minima) == 1
    lags = sorted((found.estimate["T1"], found.estimate["T2"]))
    assert lags == pytest.approx(sorted((TWO_LAGS["T1"], TWO_LAGS["T2"])), rel=1e-6)


@pytest.mark.parametrize(
    ("constraint", "value"),
    [
        (lambda p: 0.8 - p.T1 - p.T2, lambda e: 0.8 - e["T1"] - e["T2"]),
        (lambda p: p.T1 * p.T2 - 0.2, lambda e: e["T1"] * e["T2"] - 0.2),
    ],
    ids=["linear", "nonlinear"],
)
def test_an_active_constraint_holds_with_equality(constraint, value):
    found = fit(gb.Problem(LagLagDelay(), TWO, constraints=[constraint]))
    assert found.converged
    assert value(found.estimate) == pytest.approx(0, abs=1e-6)
    assert found.cost > 0.1


# --- renamed and added


def test_rename_is_how_the_outside_knows_a_parameter():
    found = fit(gb.Problem(LagLagDelay(), TWO, rename={"K": "gain"}, fixed={"tau": 0.05}))
    assert_truth(found, {"gain": 5.0, "tau": 0.05})
    assert "K" not in found.estimate


def test_parameters_may_swap_names():
    assert_truth(
        fit(gb.Problem(LagLagDelay(), TWO, rename={"K": "tau", "tau": "K"})),
        {"tau": 5.0, "K": 0.05},
    )


@pytest.mark.parametrize("delay", ["exact", "pade:2"])
def test_a_joint_fit_of_rotor_and_tilt_shares_lag_and_delay(delay):
    tilt = measured(Tilt(), TILT_OMEGA, SHARED, delay=delay)
    rotor = measured(Rotor(), ROTOR_OMEGA, ROTOR, delay=delay)
    parts = [
        gb.Problem(Tilt(), tilt, free=("T_rotor", "T_delay"), delay=delay),
        gb.Problem(Rotor(), rotor, delay=delay),
    ]
    found = fit(sum(parts))
    assert set(found.free) == {*SHARED, "K_Omega"}
    assert_truth(found, SHARED | ROTOR)


@pytest.mark.parametrize(
    "criterion", [gb.RelativeError(), gb.SquaredRelativeError(), gb.MagnitudePhase()], ids=repr
)
def test_a_joint_fit_of_noisy_data_holds_the_truth_within_four_standard_errors(criterion):
    tilt = measured(Tilt(), TILT_OMEGA, SHARED, noise=0.02, seed=1)
    rotor = measured(Rotor(), ROTOR_OMEGA, ROTOR, noise=0.02, seed=2)
    both = gb.Problem(Tilt(), tilt, criterion, free=("T_rotor", "T_delay")) + gb.Problem(
        Rotor(), rotor, criterion
    )
    joint, alone = fit(both), fit(both.parts[0])
    for name, truth in (SHARED | ROTOR).items():
        assert 0 < joint.standard_error[name] < 0.2 * abs(truth)
        assert abs(joint.estimate[name] - truth) < 4 * joint.standard_error[name]
    assert joint.standard_error["T_delay"] < alone.standard_error["T_delay"]


def test_unshared_parameters_are_renamed_apart():
    faster = measured(Rotor(), ROTOR_OMEGA, ROTOR | {"T_rotor": 0.03})
    found = fit(gb.Problem(Rotor(), SPEED) + gb.Problem(Rotor(), faster, rename={"T_rotor": "T_2"}))
    assert_truth(found, ROTOR | {"T_2": 0.03})


def test_bounds_and_start_boxes_intersect():
    class Narrow(LagLagDelay):
        K = gb.Parameter(60.0, bounds=(3, 500), starts=(50, 70))

    merged = (gb.Problem(LagLagDelay(), TWO) + gb.Problem(Narrow(), TWO)).parameters["K"]
    assert (merged.bounds, merged.box) == ((3, 100), (50, 70))


def test_weight_decides_between_data_that_disagree():
    class Gain(gb.TransferFunction):
        K = gb.Parameter(1.5, bounds=(0.1, 10))

        def response(self, s, p):
            return p.K + 0 * s

    one, two = (measured(Gain(), [1.0, 2.0], {"K": k}) for k in (1.0, 2.0))
    squares = gb.SquaredRelativeError()
    for w in (0.25, 1.0, 9.0):
        found = fit(
            gb.Problem(Gain(), one, squares, weight=w) + gb.Problem(Gain(), two, squares), starts=3
        )
        # The minimum of w (K - 1)² + (K - 2)² / 4.
        assert found.estimate["K"] == pytest.approx((w + 0.5) / (w + 0.25), rel=1e-6)


class OtherUnit(LagLagDelay):
    T1 = gb.Parameter(0.1, bounds=(0.001, 10), unit="ms")


class FarAway(LagLagDelay):
    T1 = gb.Parameter(30.0, bounds=(20, 40), unit="s")


@pytest.mark.parametrize(
    ("a", "b", "words"),
    [
        (
            {},
            {"model": OtherUnit()},
            r"'T1' has the unit 's' in one part and 'ms' in the other.*rename=\{'T1': \.\.\.\}",
        ),
        (
            {},
            {"model": FarAway()},
            r"the bounds of 'T1', \(0\.001, 10\) and \(20, 40\), do not overlap.*rename",
        ),
        (
            {},
            {"fixed": {"T1": 1.0}},
            "'T1' is fixed in one part and free in the other",
        ),
        (
            {"fixed": {"T1": 2.0}},
            {"fixed": {"T1": 1.0}},
            "'T1' is fixed at 2 in one part and at 1 in the other",
        ),
        (
            {},
            {"tied": {"T1": lambda p: p.T2}},
            "'T1' is tied in 'made 2' and free or tied differently in another part",
        ),
        (
            {"tied": {"T1": lambda p: 2 * p.T2}},
            {"tied": {"T1": lambda p: p.T2}},
            "'T1' is tied in 'made 2'",
        ),
        (
            {"tied": {"T1": lambda p: p.T2}},
            {"tied": {"T1": lambda p: 0.01 / p.T2}},
            "'T1' is tied in 'made 2'",
        ),
    ],
    ids=[
        "unit",
        "bounds",
        "fixed and free",
        "fixed twice",
        "tied and free",
        "tied twice",
        "ties that meet at start",
    ],
)
def test_parts_that_contradict_one_another_are_refused(a, b, words):
    first, second = ({"model": LagLagDelay(), "data": TWO} | changes for changes in (a, b))
    with pytest.raises(ValueError, match=words):
        gb.Problem(**first) + gb.Problem(**second)


def test_ties_that_are_alike_in_both_parts_add():
    def tie(p):
        return 10 * p.T2

    parts = [gb.Problem(LagLagDelay(), TWO, tied={"T1": tie}) for _ in range(2)]
    assert_truth(fit(sum(parts)), TWO_LAGS)


def test_only_problems_add():
    problem = gb.Problem(LagLagDelay(), TWO)
    assert sum([problem]) is problem
    assert [len(s.parts) for s in (sum([problem] * 3), problem + (problem + problem))] == [3, 3]
    for other in (3, "a", None, 0.0):
        with pytest.raises(TypeError):
            problem + other
    with pytest.raises(TypeError):
        3 + problem


def test_with_changes_every_part_and_leaves_the_original():
    both = gb.Problem(LagLagDelay(), TWO) + gb.Problem(LagLagDelay(), TWO)
    changed = both.with_(criterion=gb.SquaredRelativeError(), name="pair")
    assert changed.name == "pair"
    assert {part.criterion for part in changed.parts} == {gb.SquaredRelativeError()}
    assert {part.criterion for part in both.parts} == {gb.RelativeError()}


# --- earlier answers as fixed values


def test_a_fit_without_common_names_is_refused():
    lag = fit(gb.Problem(Lag(), measured(Lag(), TWO_LAGS_OMEGA, {"K": 2.0}), rename={"K": "G"}))
    with pytest.raises(
        ValueError,
        match="the Fit given as fixed has G, T, and none of these is a parameter here: K, T1",
    ):
        gb.Problem(LagLagDelay(), TWO, fixed=lag)
    with pytest.raises(ValueError, match="the Fit given as fixed has no estimate 'K'"):
        gb.Problem(LagLagDelay(), TWO, fixed={"K": lag})


def test_a_fit_that_failed_is_refused():
    failed = gb.fit(gb.Problem(Rotor(), SPEED), starts=2, solver_options={"max_iter": 1})
    with pytest.raises(ValueError, match="fixed gives 'T_rotor' the value nan"):
        gb.Problem(Tilt(), DATA, fixed=failed)


def test_a_tied_value_of_an_earlier_fit_keeps_its_uncertainty():
    noisy = measured(Rotor(), ROTOR_OMEGA, ROTOR, noise=0.02, seed=3)
    rotor = fit(gb.Problem(Rotor(), noisy, tied={"T_delay": lambda p: p.T_rotor / 7.5}))
    found = fit(gb.Problem(Tilt(), DATA, fixed=rotor))
    assert found.standard_error["T_delay"] == pytest.approx(
        rotor.standard_error["T_delay"], rel=1e-9
    )


def test_an_earlier_value_without_standard_error_is_not_taken_as_exact():
    few = fit(
        gb.Problem(
            Rotor(), measured(Rotor(), ROTOR_OMEGA[:2], ROTOR, noise=0.01), fixed={"T_delay": 0.008}
        )
    )
    unknown = replace(few, covariance=np.full_like(few.covariance, np.nan))
    found = fit(gb.Problem(Tilt(), DATA, fixed={"T_rotor": unknown, "T_delay": 0.008}))
    assert np.isnan(found.standard_error["T_rotor"])
    assert np.isnan(found.standard_error["a4"])


def test_a_file_is_read_before_it_is_data(tmp_path):
    path = tmp_path / "rotor.csv"
    data = measured(Rotor(), ROTOR_OMEGA, ROTOR)
    gb.data.write_response(data, path)
    problem = gb.Problem(Rotor(), gb.read_response(path))
    assert np.array_equal(problem.data.response, data.response)
    with pytest.raises(
        TypeError, match=r"data is the path .*: read the file first, gb.read_response"
    ):
        gb.Problem(Rotor(), path)


class Cube(gb.StateSpace):
    """A cubic drag, in time and about an operating point."""

    states, inputs, outputs = ("v",), ("F",), ("v",)
    c = gb.Parameter(0.4, bounds=(0.1, 5))
    m = gb.Parameter(2.0, bounds=(0.5, 9), fixed=True)

    def derivative(self, x, u, p):
        return ((u.F - p.c * x.v**3) / p.m,)

    def output(self, x, u, p):
        return (x.v,)


ROWS = gb.Record(np.arange(4.0), {"F": [0.0, 1.0, 2.0, 1.0], "v": [0.0, 0.5, np.nan, 1.0]})


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        (
            {"at": {"v": 1.0}},
            "at={'v': 1.0} is the operating point of a frequency response and this is a record: leave it out; known "
            "initial states go into OutputError(initial=...).",
        ),
        (
            {"bounds": {"m": (1, 3)}, "start": {"m": 2.5}},
            "bounds and start names 'm', which Cube declares fixed: give free=['m'] to estimate it, or "
            "fixed={'m': ...} to hold it at another value.",
        ),
        (
            {"tied": {"c": lambda p: p.m / 5}, "start": {"c": 0.5}},
            "'c' is tied, so that it has no start of its own: ",
        ),
        (
            {"fixed": {"c": 7.0}},
            "fixed gives 'c' the value 7 outside its bounds (0.1, 5): change the value, or the bounds "
            "of the parameter.",
        ),
        ({"fixed": {"c": np.nan}}, "fixed gives 'c' the value nan: give a finite number or a Fit."),
        (
            {"start": {"k": 1.0}},
            "start: Cube has no parameter 'k'; it has c, m.",
        ),
    ],
)
def test_what_a_record_cannot_be_asked_is_refused(statement, words):
    with pytest.raises(ValueError, match=f"^{re.escape(words)}"):
        gb.Problem(Cube(), ROWS, **statement)


def test_values_at_bounds_are_kept():
    for value in (0.1, 5.0):
        problem = gb.Problem(Cube(), ROWS, fixed={"c": value}, free="m")
        assert (problem.parameters["c"].start, problem.parameters["c"].fixed) == (value, True)
        assert not problem.parameters["m"].fixed
    assert gb.Problem(Cube(), ROWS, bounds={"m": (1, 3)}, free=["m"]).parameters["m"].bounds == (
        1,
        3,
    )
    with pytest.raises(
        TypeError, match=r"^bounds is \['c'\]: give \{name of a parameter: \.\.\.\}\.$"
    ):
        gb.Problem(Cube(), ROWS, bounds=["c"])


def test_help_shows_the_options():
    assert {"model", "fixed", "prior"} < {*inspect.signature(gb.Problem).parameters}
