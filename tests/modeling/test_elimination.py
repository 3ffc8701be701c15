"""Elimination in a chosen order, against numpy's pivoted solution."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import greybox as gb
from greybox.modeling.elimination import elimination_order, solve, solve_pencils
from greybox.modeling.linear_response import response_formula

OMEGA = np.array([1.0, 2.0, 4.0, 8.0, 16.0])


class Resonator(gb.StateSpace):
    """A damped system whose first two states alone are an undamped oscillator at 4 rad/s, a frequency of the data."""

    states, inputs, outputs = ("x", "v", "z"), ("u",), ("y",)
    k = gb.Parameter(16.0, bounds=(0, 100), fixed=True)
    c = gb.Parameter(3.0, bounds=(0, 50))
    b = gb.Parameter(2.0, bounds=(0, 50))
    T = gb.Parameter(0.3, bounds=(0.01, 5))

    def derivative(self, x, u, p):
        return x.v, -p.k * x.x - p.c * x.z + p.b * u.u, (x.v - x.z) / p.T

    def output(self, x, u, p):
        return (x.x,)


def entries(A):
    return [[None if a == 0 else a for a in row] for row in A]


@given(st.integers(0, 10_000), st.integers(1, 6))
@settings(max_examples=60, deadline=None)
def test_every_order_solves_a_regular_system(seed, n):
    random = np.random.default_rng(seed)
    A = random.normal(size=(n, n)) * (random.random((n, n)) < 0.6)
    b = random.normal(size=n)
    order = tuple(int(i) for i in random.permutation(n))
    s = 3.0 + 2.0j  # away from every leading minor's roots, almost surely
    expected = np.linalg.solve(s * np.eye(n) - A, b)
    assert solve(entries(A), list(b), s, order) == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_a_sub_block_that_resonates_at_a_data_frequency_is_eliminated_in_another_order():
    A = np.array([[0.0, 1, 0], [-16, 0, -3], [0, 1 / 0.3, -1 / 0.3]])
    b = np.array([0.0, 2, 0])
    order = elimination_order(A[None], b[None], A == 0, OMEGA)
    found = np.stack(solve(entries(A), list(b), 1j * OMEGA, order), axis=-1)
    expected = solve_pencils(
        1j * OMEGA[:, None, None] * np.eye(3) - A, np.broadcast_to(b.astype(complex), (5, 3))
    )
    assert found == pytest.approx(expected, rel=1e-12)


def test_such_a_model_is_fitted():
    truth = {"c": 5.0, "b": 7.0, "T": 0.2}
    fit = gb.fit(
        gb.Problem(Resonator(), gb.frequency_response(Resonator(), truth, OMEGA)),
        starts=10,
        progress=False,
    )
    assert fit.agreeing == 10
    assert {name: fit.estimate[name] for name in truth} == pytest.approx(truth, rel=1e-6)


class Chain(gb.StateSpace):
    """Nine lags whose time constants span four decades: no digits may be lost."""

    lags = (0.003, 0.01, 0.01, 0.05, 0.2, 1.0, 3.0, 10.0, 20.0)
    states, inputs, outputs = tuple("abcdefghi"), ("u",), ("y",)
    K = gb.Parameter(1.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        into = [p.K * u.u, *list(x.values())[:-1]]
        return [
            (before - after) / T
            for before, after, T in zip(into, x.values(), self.lags, strict=True)
        ]

    def output(self, x, u, p):
        return (x.i,)


def test_stiff_systems_keep_their_digits():
    omega = np.geomspace(0.01, 300, 40)
    re, im = response_formula(Chain(), omega).closed()([2.0])
    expected = 2 / np.prod([1 + 1j * omega * T for T in Chain.lags], axis=0)
    assert np.asarray(re).ravel() + 1j * np.asarray(im).ravel() == pytest.approx(
        expected, rel=1e-12
    )


def test_a_pole_on_the_axis_is_named_and_spoils_no_other_frequency():
    class Undamped(Resonator):
        c = gb.Parameter(0.0, bounds=(0, 50))

    with pytest.raises(
        ValueError, match="no finite response at omega = 4 rad/s: a pole lies there"
    ):
        gb.frequency_response(Undamped(), {}, OMEGA)
    assert np.all(np.isfinite(gb.frequency_response(Undamped(), {}, [1.0, 5.0]).response))


def test_a_singular_matrix_spoils_no_other_one():
    regular, right = np.array([[2.0, 1], [0, 4]]), np.array([5.0, 8])
    found = solve_pencils(np.array([regular, np.ones((2, 2)), 1j * regular]), np.array([right] * 3))
    assert found[0] == pytest.approx([1.5, 2])
    assert np.isnan(found[1]).all()
    assert found[2] == pytest.approx([-1.5j, -2j])


def test_the_first_order_that_is_accurate_is_taken():
    """The natural one, of matrices without small pivots; the next one where its second pivot vanishes."""
    for seed in range(5):
        random = np.random.default_rng(seed)
        A, b = random.normal(size=(2, 4, 4)), random.normal(size=(2, 4))
        assert elimination_order(A, b, np.zeros((4, 4), dtype=bool), OMEGA) == (0, 1, 2, 3)
    A = np.array(
        [[0.0, 4, 0], [-4, 0, -3], [0, 2, -3]]
    )  # of the first two alone, 4 rad/s is an eigenvalue
    assert elimination_order(A[None], np.array([[0.0, 2, 0]]), A == 0, OMEGA)[:2] != (0, 1)
    assert elimination_order(A[None, :1, :1], np.ones((1, 1)), A[:1, :1] == 0, OMEGA) == (0,)
