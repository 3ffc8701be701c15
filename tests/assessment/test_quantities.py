"""The lines of an answer: names of derived quantities, and errors that follow from the gradient."""

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from numpy.testing import assert_allclose

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")


def lag(name, seed=0, **values):
    return measured(
        Lag(), TWO_LAGS_OMEGA, {"K": 2.0, "T": 0.3} | values, noise=0.02, name=name, seed=seed
    )


def fit(problem):
    return gb.fit(problem, starts=2, progress=False)


def test_lines_stand_in_the_order_of_free_and_fixed_then_tied_then_derived():
    class Pair(LagLagDelay):
        derived = {"ratio": lambda p: p.T1 / p.T2}

    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.02)
    found = fit(gb.Problem(Pair(), data, fixed={"tau": 0.05}, tied={"T1": lambda p: 3 * p.T2}))
    assert [(q.name, q.kind) for q in found.quantities] == [
        ("K", "free"),
        ("T2", "free"),
        ("tau", "fixed"),
        ("T1", "tied"),
        ("ratio", "derived"),
    ]
    assert found.derived["ratio"] == pytest.approx(3)
    assert found.standard_error["ratio"] == pytest.approx(0, abs=1e-9)
    assert found.standard_error["T1"] == pytest.approx(3 * found.standard_error["T2"])
    assert found.names == ("K", "T2", "tau", "T1")
    covariance = found.covariance_of(("T2", "T1"))
    assert_allclose(covariance, np.array([[1, 3], [3, 9]]) * covariance[0, 0], rtol=1e-9)


def test_errors_of_derived_quantities_follow_from_the_gradient():
    found = fit(gb.Problem(Lag(), lag("one")))
    K, T = found.estimate["K"], found.estimate["T"]
    slope = np.array([T**2, 2 * K * T])
    expected = np.sqrt(slope @ found.covariance_of(("K", "T")) @ slope)
    assert found.derived["area"] == pytest.approx(K * T**2)
    assert found.standard_error["area"] == pytest.approx(expected)


def test_parts_that_rename_have_derived_quantities_of_their_own():
    one, two = (
        gb.Problem(Lag(), lag("one")),
        gb.Problem(Lag(), lag("two", 1), rename={"T": "T_two"}),
    )
    assert set(fit(one + two).derived) == {"bandwidth", "area", "bandwidth (two)", "area (two)"}
    assert set(fit(one + gb.Problem(Lag(), lag("two", 1))).derived) == {"bandwidth", "area"}
    namesake = gb.Problem(Lag(), lag("two", 2), rename={"T": "T_three"})
    assert {"bandwidth (two 1)", "bandwidth (two 2)"} <= {*fit(one + two + namesake).derived}


def test_what_depends_on_the_undetermined_has_no_error():
    class Product(Lag):
        half = gb.Parameter(1.0, bounds=(0.1, 10))
        derived = {"gain": lambda p: p.K * p.half, "twice": lambda p: 2 * p.half}

        def response(self, s, p):
            return p.half * super().response(s, p)

    found = fit(gb.Problem(Product(), lag("one")))
    assert np.isnan([found.standard_error[name] for name in ("K", "half", "twice")]).all()
    assert found.standard_error["gain"] == pytest.approx(
        fit(gb.Problem(Lag(), lag("one"))).standard_error["K"], rel=0.02
    )
    assert np.isnan(found.covariance_of(("K", "T"))[0]).all()
    assert found.covariance_of(("T",))[0, 0] > 0


def test_a_tied_parameter_at_its_bound_is_marked_and_what_is_derived_of_it_is_not():
    for bounds, at_bound in (((0.3, 0.5), True), ((0.1, 0.5), False)):
        found = fit(
            gb.Problem(Lag(), lag("one"), tied={"T": lambda p: p.K / 10}, bounds={"T": bounds})
        )
        marked = {q.name: q.at_bound for q in found.quantities}
        assert marked["T"] is at_bound
        assert not marked["area"]
    assert found.estimate["T"] < 0.3
