"""Elimination in a chosen order, against numpy's pivoted solution."""

import numpy as np
import pytest
from evaluation import response_formula
from hypothesis import given, settings, strategies as st

import greybox as gb
from greybox.modeling.elimination import eliminated, elimination_order, solve_pencils

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


def entries(system):
    return [[None if a == 0 else a for a in row] for row in system]


def bordered(A, b, c, d):
    """The matrix [[-A, b], [-c, d]]."""
    return np.block([[-A, b[:, None]], [-c[None], np.atleast_2d(d)]])


def response(A, b, c, d, s):
    return d + c @ np.linalg.solve(s * np.eye(len(A)) - A, b)


@given(st.integers(0, 10_000), st.integers(0, 6))
@settings(max_examples=60, deadline=None)
def test_every_order_eliminates_a_regular_system(seed, n):
    random = np.random.default_rng(seed)
    A = random.normal(size=(n, n)) * (random.random((n, n)) < 0.6)
    b, c = random.normal(size=(2, n)) * (random.random((2, n)) < 0.8)
    d = random.normal()
    order = tuple(int(i) for i in random.permutation(n))
    s = 3.0 + 2.0j  # away from every leading minor's roots, almost surely
    [[found]] = eliminated(entries(bordered(A, b, c, d)), s, order)
    assert found == pytest.approx(response(A, b, c, d, s), rel=1e-6, abs=1e-9)


def test_a_sub_block_that_resonates_at_a_data_frequency_is_eliminated_in_another_order():
    A = np.array([[0.0, 1, 0], [-16, 0, -3], [0, 1 / 0.3, -1 / 0.3]])
    b, c = np.array([0.0, 2, 0]), np.array([1.0, 0, 0])
    system = bordered(A, b, c, 0.0)
    order = elimination_order(A[None], OMEGA)
    [[found]] = eliminated(entries(system), 1j * OMEGA, order)
    expected = [response(A, b, c, 0.0, s) for s in 1j * OMEGA]
    assert found == pytest.approx(np.array(expected), rel=1e-12)


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


def test_the_first_order_without_a_vanishing_pivot_is_taken():
    """The natural one of random matrices; the reverse where the second pivot vanishes."""
    for seed in range(5):
        systems = np.random.default_rng(seed).normal(size=(2, 4, 4))
        assert elimination_order(systems, OMEGA) == (0, 1, 2, 3)
    # Of the first two alone, 4 rad/s is an eigenvalue.
    A = np.array([[0.0, 4, 0], [-4, 0, -3], [0, 2, -3]])
    assert elimination_order(A[None], OMEGA) == (2, 1, 0)
    assert elimination_order(A[None, :1, :1], OMEGA) == (0,)
    assert elimination_order(np.zeros((0, 3, 3)), OMEGA) == (0, 1, 2)
