"""Bounds and starts of a problem in place of those that the model declares."""

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, Parabola, measured

import greybox as gb
from greybox.assessment.fitted_problem import problem_of

TWO = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS)
LAG = measured(Lag(), TWO_LAGS_OMEGA, {"K": 2.0, "T": 0.3}, noise=0.05)


def fit(problem, starts=6):
    return gb.fit(problem, starts=starts, progress=False)


def test_the_estimate_is_found_within_other_bounds_or_ends_at_them():
    assert fit(gb.Problem(Lag(), LAG, bounds={"K": (0.5, 4)})).estimate["K"] == pytest.approx(
        2.0, rel=0.1
    )
    found = fit(gb.Problem(Lag(), LAG, bounds={"K": (3, 2e3)}))
    (gain,) = (q for q in found.quantities if q.name == "K")
    assert gain.value == pytest.approx(3)
    assert gain.at_bound
    assert gain.bounds == (3, 2e3)  # wider than declared on one side
    # Of the other parameter nothing has changed.
    assert next(q.bounds for q in found.quantities if q.name == "T") == Lag.parameters["T"].bounds


def test_starts_are_drawn_in_the_box_that_is_given():
    problem = gb.Problem(
        LagLagDelay(), TWO, starts={"K": (1.5, 3)}, bounds={"T1": (0.2, 3)}, start={"T2": 0.4}
    )
    begun = np.array([run.start for run in fit(problem, 16).runs])
    assert 1.5 <= begun[:, 0].min() < begun[:, 0].max() <= 3
    assert 0.2 <= begun[:, 1].min() < begun[:, 1].max() <= 3
    (single,) = fit(problem, [{}]).runs
    # Declared are 1, 0.1, 0.1 and 0.01: the first two lie outside, and move to the nearest value
    # inside.
    np.testing.assert_allclose(single.start, [1.5, 0.2, 0.4, 0.01])


def test_a_declared_start_box_is_cut_to_the_bounds():
    class Boxed(Lag):
        K = gb.Parameter(1.0, bounds=(1e-3, 1e3), unit="m", scale="log", starts=(0.1, 10))

    def box(**options):
        return gb.Problem(Boxed(), LAG, **options).parameters["K"].box

    assert box() == (0.1, 10)
    assert box(bounds={"K": (1, 1e4)}) == (1, 10)
    assert box(bounds={"K": (20, 30)}) == (20, 30)
    assert box(bounds={"K": (10, 30)}) == (10, 10)
    assert box(bounds={"K": (0.01, 0.1)}) == (0.1, 0.1)
    assert box(bounds={"K": (2, np.inf)}) == (2, 10)
    # Without a declared one, starts need a finite interval all the same.
    assert gb.Problem(Lag(), LAG, bounds={"K": (2, np.inf)}).parameters["K"].box == (2, 1e3)
    assert box(bounds={"K": (20, 30)}, starts={"K": (25, 26)}) == (25, 26)


def test_bounds_of_a_tied_parameter_limit_its_expression():
    problem = gb.Problem(
        LagLagDelay(), TWO, tied={"T1": lambda p: 20 * p.T2}, bounds={"T1": (0.1, 0.2)}
    )
    found = fit(problem)
    assert 0.1 <= found.estimate["T1"] <= 0.2 + 1e-6


def test_bounds_of_parts_intersect_and_names_are_those_of_the_model():
    problem = gb.Problem(Lag(), LAG, bounds={"K": (1, 5)}, rename={"K": "gain"})
    assert problem.parameters["gain"].bounds == (1, 5)
    other = gb.Problem(
        Lag(), measured(Lag(), [1.0, 2.0]), bounds={"K": (2, 9)}, rename={"K": "gain"}
    )
    assert (problem + other).parameters["gain"].bounds == (2, 5)
    assert problem.with_(bounds={}).parameters["gain"].bounds == (1e-3, 1e3)


def test_what_judges_a_fit_later_knows_its_bounds(tmp_path):
    found = fit(gb.Problem(Lag(), LAG, bounds={"K": (2.5, 5)}, starts={"K": (3, 4)}))
    gb.save(found, tmp_path / "fit.h5")
    loaded = gb.load(tmp_path / "fit.h5", models=[Lag])
    assert problem_of(loaded).parameters["K"].bounds == (2.5, 5)
    assert problem_of(loaded).parameters["K"].box == (3, 4)
    assert loaded.to_dict()["starts_box"]["K"] == [3, 4]
    assert loaded.at_estimate().declared["K"].bounds == (2.5, 5)


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ({"bounds": {"b": (0, 1)}}, "bounds: LagLagDelay has no parameter 'b'"),
        ({"bounds": {"K": (2, 1)}}, r"K: bounds \(2.0, 1.0\) are reversed or empty"),
        ({"bounds": {"K": 3}}, r"K: bounds 3 must be a pair"),
        (
            {"bounds": {"K": (0, 0.5)}, "start": {"K": 1}},
            r"K: start 1 lies outside bounds \(0, 0.5\)",
        ),
        ({"start": {"K": np.nan}}, "K: start nan is not a finite number"),
        ({"starts": {"K": (-1, 1)}}, r"K: starts \(-1, 1\) reach outside bounds \(0, 100\)"),
        ({"starts": {"K": (0, np.inf)}}, "K: starts .* must be two finite numbers"),
        (
            {"start": {"T1": 1}, "tied": {"T1": lambda p: p.T2}},
            "'T1' is tied, so that it has no start",
        ),
        (
            {"fixed": {"K": 3}, "bounds": {"K": (0, 2)}},
            r"outside its bounds \(0, 2\): change the value, or the bounds",
        ),
    ],
)
def test_what_a_parameter_cannot_have_is_refused(statement, words):
    with pytest.raises(ValueError, match=words):
        gb.Problem(LagLagDelay(), TWO, **statement)


def test_things_that_are_no_mapping_and_parameters_that_are_not_free_are_refused():
    with pytest.raises(TypeError, match=r"bounds is .* give \{name of a parameter: \.\.\.\}"):
        gb.Problem(LagLagDelay(), TWO, bounds=[("K", 0, 1)])
    data = measured(Parabola(), [1.0, 2.0])
    with pytest.raises(
        ValueError,
        match=r"bounds names 'slope', which Parabola declares fixed: give free=\['slope'\]",
    ):
        gb.Problem(Parabola(), data, bounds={"slope": (0, 1)})
    assert gb.Problem(Parabola(), data, bounds={"slope": (0, 1)}, free=["slope"]).parameters[
        "slope"
    ].bounds == (0, 1)
