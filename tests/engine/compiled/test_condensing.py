"""The linear algebra of multiple shooting, held against the same system as one dense matrix."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from greybox.engine.compiled import condensing
from greybox.engine.compiled.condensing import solve_continuity


@pytest.fixture(autouse=True)
def _without_ridge(monkeypatch):
    """The dense system has no ridge, and must be found to all digits."""
    monkeypatch.setattr(condensing, "RIDGE", 0.0)


def made(s, n, r, coupled, seed=0, definite=True):
    random = np.random.default_rng(seed)
    root = random.normal(size=(s, n, n))
    hessian = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(n) if definite else np.zeros((s, n, n))
    return {
        "hessian": hessian,
        "transition": random.normal(size=(s, n, n)),
        "coupled": np.array(coupled, dtype=bool),
        "stationarity": random.normal(size=(s, n, r)),
        "continuity": random.normal(size=(s, n, r)),
    }


def dense(hessian, transition, coupled, stationarity, continuity, variance):
    """The system of the docstring, written out."""
    s, n, r = stationarity.shape
    matrix, right = np.zeros((2 * s * n, 2 * s * n)), np.zeros((2 * s * n, r))
    x = [slice(k * n, (k + 1) * n) for k in range(s)]
    f = [slice((s + k) * n, (s + k + 1) * n) for k in range(s)]
    for j in range(s):
        matrix[x[j], x[j]] = hessian[j]
        right[x[j]] = stationarity[j]
        if coupled[j]:
            matrix[x[j], f[j]], matrix[f[j], x[j]] = transition[j].T, transition[j]
            matrix[x[j + 1], f[j]], matrix[f[j], x[j + 1]] = -np.eye(n), -np.eye(n)
            matrix[f[j], f[j]] = -np.diag(variance)
            right[f[j]] = continuity[j]
        else:
            matrix[f[j], f[j]] = np.eye(n)
    solution = np.linalg.solve(matrix, right)
    return solution[: s * n].reshape(s, n, r), solution[s * n :].reshape(s, n, r)


CUTS = {
    "one": [0],
    "two": [1, 0],
    "chain": [1] * 11 + [0],
    "pieces": [1, 1, 0, 0, 1, 0, 1, 1, 1, 0],
    "loose": [0] * 6,
}


@pytest.mark.parametrize("halved_from", [1, 10**9])
@pytest.mark.parametrize("variance", [0.0, 0.7])
@pytest.mark.parametrize("cut", CUTS)
@pytest.mark.parametrize(("n", "r"), [(1, 1), (3, 1), (4, 6)])
def test_it_is_the_dense_solution(cut, n, r, variance, halved_from, monkeypatch):
    monkeypatch.setattr(condensing, "LONG_CHAIN", halved_from)
    system = made(len(CUTS[cut]), n, r, CUTS[cut], seed=n + r)
    variance = variance * np.arange(1, n + 1.0)
    for found, wanted in zip(
        solve_continuity(**system, variance=variance),
        dense(**system, variance=variance),
        strict=True,
    ):
        assert_allclose(found, wanted, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("growth", [0.5, 1.0, 6.0])
def test_halves_of_long_chains_keep_their_digits_stable_or_not(growth):
    """Of two oscillators with a known end: over six segments, the last one grows by 50 000."""
    s, n = 400, 2
    system = made(s, n, 2, [1] * (s - 1) + [0])
    system["transition"] = np.tile(growth * np.array([[0.6, -0.8], [0.8, 0.6]]), (s, 1, 1))
    x, force = solve_continuity(**system)
    gaps = system["transition"][:-1] @ x[:-1] - x[1:] - system["continuity"][:-1]
    assert np.abs(gaps).max() < 1e-12 * max(np.abs(x).max(), 1)
    back = np.concatenate([np.zeros((1, n, 2)), force[:-1]])
    still = system["hessian"] @ x + system["transition"].mT @ force - back
    assert_allclose(still, system["stationarity"], atol=1e-10 * max(np.abs(force).max(), 1))


def test_exact_continuity_holds_and_uncoupled_segments_have_no_multiplier():
    system = made(10, 3, 2, CUTS["pieces"])
    x, force = solve_continuity(**system, variance=np.zeros(3))
    on = np.flatnonzero(system["coupled"])
    gaps = system["transition"][on] @ x[on] - x[on + 1] - system["continuity"][on]
    assert_allclose(gaps, 0, atol=1e-10)
    assert np.all(force[~system["coupled"]] == 0)


def test_data_at_the_end_alone_determine_the_states_before():
    system = made(8, 2, 1, [1] * 7 + [0], definite=False)
    system["hessian"][-1] = np.eye(2)
    for found, wanted in zip(
        solve_continuity(**system, variance=np.zeros(2)),
        dense(**system, variance=np.zeros(2)),
        strict=True,
    ):
        assert_allclose(found, wanted, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_states_of_very_different_size(size):
    """Scaling a state by `size` scales its solution back."""
    system = made(12, 3, 2, CUTS["chain"])
    plain, _ = solve_continuity(**system, variance=np.zeros(3))
    scale = np.array([1.0, size, 1 / size])
    scaled = {
        "hessian": system["hessian"] / scale / scale[:, None],
        "transition": system["transition"] * scale[:, None] / scale,
        "coupled": system["coupled"],
        "stationarity": system["stationarity"] / scale[:, None],
        "continuity": system["continuity"] * scale[:, None],
    }
    found, _ = solve_continuity(**scaled, variance=np.zeros(3))
    assert_allclose(found / scale[:, None], plain, rtol=1e-6, atol=1e-8 * np.abs(plain).max())


def test_states_that_outputs_show_ever_later_follow_the_first_node():
    """In a chain, an output shows the masses far from it by ever smaller shares of a segment."""
    s, n = 12, 30
    system = made(s, n, 1, [1] * (s - 1) + [0])
    system["hessian"] = np.tile(np.diag(10.0 ** (-2 * np.arange(n))), (s, 1, 1))
    system["transition"] = np.tile(0.6 * np.eye(n) + 0.3 * np.eye(n, k=1), (s, 1, 1))
    system["transition"][0] = 0  # the first node is known
    x, _ = solve_continuity(**system, variance=np.zeros(n))
    wanted = -system["continuity"][0]
    for j in range(1, s - 1):
        assert_allclose(x[j], wanted, rtol=1e-5, atol=1e-8)
        wanted = system["transition"][j] @ wanted - system["continuity"][j]


def test_the_ridge_holds_first_nodes_alone(monkeypatch):
    """Where a transition grows by decades, it would outweigh what the outputs show of later nodes.

    The first state then has a tiny size in the mean over the segments.
    """
    system = made(6, 2, 2, [1, 1, 1, 1, 1, 0])
    system["hessian"] = np.tile(np.diag([1.0, 1e18]), (6, 1, 1))
    system["transition"][:, 1, 0] = 0
    system["transition"][5, 1, 0] = 1e9
    system["stationarity"][:, 1] = system["continuity"][:, 1] = 0
    wanted = solve_continuity(**system)
    monkeypatch.setattr(condensing, "RIDGE", 1e-10)
    for values, expected in zip(solve_continuity(**system), wanted, strict=True):
        assert_allclose(values[:, 0], expected[:, 0], rtol=1e-6)


def test_a_singular_system_says_so():
    system = made(3, 2, 1, [1, 1, 0], definite=False)
    with pytest.raises(np.linalg.LinAlgError):
        solve_continuity(**system, variance=np.zeros(2))


def test_no_states():
    x, force = solve_continuity(**made(5, 0, 3, [1, 1, 1, 1, 0]), variance=np.zeros(0))
    assert x.shape == force.shape == (5, 0, 3)
