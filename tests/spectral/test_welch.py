"""The estimate with windows of one length, against the formulas that it generalizes."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from greybox.spectral import welch
from greybox.spectral.uniform_stretches import UniformStretch


def test_formula_of_bendat_and_piersol():
    """Without leakage terms and overlap, white input: variance (1 - γ²) / (γ² (n - 1)) |P|², dof 2 (n - 1)."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal(2000)
    values = np.array([u, u + rng.standard_normal(2000), u])
    got = welch.estimate(welch.transforms([UniformStretch(values, 0.1, "")], 10.0, 0.0, np.array([5.0])), 0)
    assert got.dof == pytest.approx(2 * 19)
    expected = (1 - got.coherence) / (got.coherence * 19) * abs(got.response) ** 2
    assert got.variance == pytest.approx(expected)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_traces_are_those_of_the_matrices(order):
    rng = np.random.default_rng(order)
    n, p = 12, order + 1
    c = np.corrcoef(rng.standard_normal((n, 30)))
    left, right = rng.standard_normal((2, n, p)) + 1j * rng.standard_normal((2, n, p))
    q = np.eye(n) - left @ right.conj().T
    m = q @ c @ q.conj().T
    np.testing.assert_allclose(welch._traces(csr_array(c), left, right), [np.trace(m).real, np.trace(m @ m).real])


def test_stretches_as_long_as_a_window_have_one_each():
    rng = np.random.default_rng(0)
    noisy = [(u, u + v, u) for u, v in rng.standard_normal((20, 2, 100))]
    stretches = [UniformStretch(np.array(values), 0.1, "") for values in noisy]
    cut = UniformStretch(np.concatenate([s.values for s in stretches], axis=1), 0.1, "")
    apart, together = (
        welch.estimate(welch.transforms(given, 10.0, 0.0, np.array([5.0])), 0) for given in (stretches, [cut])
    )
    assert apart.response == pytest.approx(together.response)
    assert apart.dof == pytest.approx(2 * 19)
