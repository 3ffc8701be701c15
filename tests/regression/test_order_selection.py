"""The choice of orders: too high ones lead down to the true ones; the tables of the paper."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import assume, given
from numpy.testing import assert_allclose
from rational_functions import ROOTS, polynomial, simulated, table

import greybox as gb
from greybox.regression.order_selection import OrderPath, order_path


@given(st.permutations(ROOTS), st.integers(1, 2), st.integers(1, 2), st.booleans())
def test_path_from_too_high_ends_at_the_true_orders(roots, above, excess, integrator):
    numerator, denominator = polynomial(roots[:1]), polynomial(roots[1 : 2 + above])
    denominator = np.append(denominator, 0.0) if integrator else denominator
    n, m = len(denominator) - 1, len(numerator) - 1
    assume(m < n)
    path = order_path(simulated(numerator, denominator), n + excess, m + excess, integrator)
    assert path.orders == tuple((n + k, m + k) for k in range(excess, -1, -1))
    assert_allclose(
        path.fit.denominator, denominator, rtol=1e-6, atol=1e-7 * np.abs(denominator).max()
    )
    assert path.reasons[0] == "rank deficient"


def test_path_drops_a_stable_pair_and_keeps_an_unstable_one():
    stable = simulated([1, 4.04], polynomial([-4, -1.5 + 2j]))
    path = order_path(stable, 3, 1)
    assert path.orders == ((3, 1), (2, 0))
    assert path.reasons == (
        "stable zero -4.04 and pole -4, 0.99 % apart",
        "no stable pair within 10 %",
    )
    assert order_path(stable, 3, 1, tolerance=0.005).orders == ((3, 1),)
    unstable = simulated([1, -4.04], polynomial([4, -1.5 + 2j]))
    assert order_path(unstable, 3, 1).orders == ((3, 1),)
    assert order_path(unstable, 3, 1, unstable=True).orders == ((3, 1), (2, 0))


def test_path_ends_at_a_constant_numerator():
    silent = gb.FrequencyResponse([1.0, 2.0, 3.0], [0.0, 0.0, 0.0])
    path = order_path(silent, 2, 1)
    assert (path.orders, path.reasons[-1]) == (((2, 1), (1, 0)), "rank deficient, but m is 0")


@pytest.mark.parametrize(
    ("name", "start", "end", "end_unstable"),
    [
        ("roll", (4, 1), (4, 1), (4, 1)),
        ("roll", (7, 4), (6, 3), (5, 2)),
        ("roll", (10, 7), (6, 3), (5, 2)),
        ("pitch", (4, 1), (4, 1), (4, 1)),
        ("pitch", (7, 4), (7, 4), (5, 2)),
        ("pitch", (9, 6), (7, 4), (5, 2)),
        ("yaw", (4, 1), (4, 1), (4, 1)),
        ("yaw", (7, 4), (7, 4), (7, 4)),
        ("yaw", (10, 7), (9, 6), (9, 6)),
    ],
)
def test_path_on_the_tables_of_the_paper(name, start, end, end_unstable):
    """The paper's (4, 1) is where the rule ends only when it begins there."""
    options = {"integrator": name == "yaw"}
    assert order_path(table(name), *start, **options).orders[-1] == end
    assert order_path(table(name), *start, **options, unstable=True).orders[-1] == end_unstable


def test_a_path_prints_itself():
    path = order_path(table("roll"), 7, 4)
    assert isinstance(path, OrderPath)
    first, last, form = str(path).splitlines()[2:]
    assert first.split()[:6] == ["7", "4", "1.5774", "-18.08", "1", "0"]
    assert first.endswith("stable zero -0.243 ± 13.96j and pole -0.148 ± 14.01j, 0.76 % apart")
    assert last.split()[:6] == ["6", "3", "0.72859", "-77.34", "0", "1"]
    assert last.endswith("<- ends here: no stable pair within 10 %")
    assert form == f"P(s) = {path.fit.factored}"


@pytest.mark.parametrize("tolerance", [0, -1.0, 1.5, float("nan")])
def test_bad_tolerance(tolerance):
    with pytest.raises(
        ValueError, match="it is a relative distance, give a number above 0 and at most 1"
    ):
        order_path(table("roll"), 7, 4, tolerance=tolerance)
