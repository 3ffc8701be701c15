"""The estimate with windows of one length, against the formulas that it generalizes."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from greybox.data.frequency_response import FrequencyResponse, Stretch
from greybox.spectral import welch
from greybox.spectral.uniform_stretches import UniformStretch


def test_formula_of_bendat_and_piersol():
    """Without leakage terms and overlap, white input: variance (1 - γ²) / (γ² (n - 1)) |P|², dof 2 (n - 1)."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal(2000)
    values = np.array([u, u + rng.standard_normal(2000), u])
    got = welch.estimate(
        welch.transforms([UniformStretch(values, 0.1, "")], 10.0, 0.0, np.array([5.0])), 0
    )
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
    np.testing.assert_allclose(
        welch.traces(csr_array(c), left, right), [np.trace(m).real, np.trace(m @ m).real]
    )


def test_stretches_as_long_as_a_window_have_one_each():
    rng = np.random.default_rng(0)
    noisy = [(u, u + v, u) for u, v in rng.standard_normal((20, 2, 100))]
    stretches = [UniformStretch(np.array(values), 0.1, "") for values in noisy]
    cut = UniformStretch(np.concatenate([s.values for s in stretches], axis=1), 0.1, "")
    apart, together = (
        welch.estimate(welch.transforms(given, 10.0, 0.0, np.array([5.0])), 0)
        for given in (stretches, [cut])
    )
    assert apart.response == pytest.approx(together.response)
    assert apart.dof == pytest.approx(2 * 19)


def complexes(rng, *shape):
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


@pytest.mark.parametrize("joint", [False, True])
def test_an_estimate_is_that_of_its_matrices(joint):
    """Of correlated windows, with a second input and leakage, by matrices that are written out."""
    rng = np.random.default_rng(2)
    n = 15
    x, y = complexes(rng, n, 3), complexes(rng, n)
    x[:, 0] *= 5
    z = x.copy()
    if joint:
        z[:, 0] = x[:, 0] + 2 * complexes(rng, n)
    y = y + 2 * x[:, 0]
    c = np.corrcoef(rng.standard_normal((n, 60)))
    columns = [[column[:, None] for column in side.T] for side in (x, z)]
    spectra = welch.Transforms(x[:, :1], y[:, None], z[:, :1], *columns, csr_array(c), 2)
    found = welch.estimate(spectra, 0)

    solution = np.linalg.solve(z.conj().T @ x, z.conj().T)
    q = np.eye(n) - x @ solution
    m = q @ c @ q.conj().T
    noise = np.linalg.norm(q @ y) ** 2 / np.trace(m).real
    assert found.response == pytest.approx(solution[0] @ y)
    assert found.dof == pytest.approx(2 * np.trace(m).real ** 2 / np.trace(m @ m).real)
    assert found.variance == pytest.approx(noise * (solution[0] @ c @ solution[0].conj()).real)

    def left(signal):
        return signal - x[:, 1:] @ np.linalg.lstsq(x[:, 1:], signal, rcond=None)[0]

    pairs = [(left(z[:, 0]), left(other)) for other in ((y, x[:, 0]) if joint else (y,))]
    shares = [abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a) * np.vdot(b, b)).real for a, b in pairs]
    assert found.coherence == pytest.approx(min(shares))


def test_what_instruments_leave_of_an_input_is_its_density():
    rng = np.random.default_rng(3)
    z, u = complexes(rng, 12, 2), complexes(rng, 12)
    c = np.corrcoef(rng.standard_normal((12, 60)))
    q = np.eye(12) - z @ np.linalg.pinv(z)
    expected = np.linalg.norm(q @ u) ** 2 / np.trace(q @ c @ q.conj().T).real
    assert welch.unexplained(csr_array(c), u, z) == pytest.approx(expected)


def test_columns_are_solvable_whatever_their_length():
    rng = np.random.default_rng(4)
    x, z = complexes(rng, 6, 2), complexes(rng, 6, 2)
    assert welch.solvable(z * [1e8, 1e-8], x * [1e-9, 1e9])
    assert not welch.solvable(z, x[:, [0, 0]])
    assert not welch.solvable(z[:2], x[:2])


def test_windows_are_transformed_at_the_time_of_the_stretch():
    """By sums that are written out, with the correlation of windows that overlap; a short stretch has none."""
    rng = np.random.default_rng(5)
    values, omega, step = rng.standard_normal((4, 100)), np.array([3.0, 7.0]), 0.05
    stretches = [UniformStretch(values, step, ""), UniformStretch(values[:, :30], step, "")]
    found = welch.transforms(stretches, 2.0, 0.5, omega, leakage_terms=1)
    count, hop = 40, 20
    begins = range(0, 61, hop)
    phase = 2 * np.pi * (np.arange(count) + 0.5) / count
    tapers = [0.5 - 0.5 * np.cos(phase), 0.5 * np.sin(phase)]

    def transform(signal, taper):
        at = np.add.outer(begins, np.arange(count))
        return step * np.einsum(
            "bk,k,wbk->bw", signal[at], taper, np.exp(-1j * np.multiply.outer(omega, at * step))
        )

    np.testing.assert_allclose(
        [found.u, found.y, found.r], [transform(v, tapers[0]) for v in values[:3]]
    )
    expected = [transform(values[0], tapers[0]), transform(values[3], tapers[0])]
    expected += [transform(values[0], tapers[1]), transform(values[3], tapers[1])]
    np.testing.assert_allclose(found.regressors, expected)
    np.testing.assert_allclose(
        found.instruments[::2], [transform(values[2], taper) for taper in tapers]
    )
    assert found.inputs == 2
    own, next_ = step * np.sum(tapers[0] ** 2), step * np.sum(tapers[0][:20] * tapers[0][20:])
    correlation = own * np.eye(4) + next_ * (np.eye(4, k=1) + np.eye(4, k=-1))
    np.testing.assert_allclose(found.correlation.toarray(), correlation)


def test_a_window_of_fewer_than_two_periods_gives_nothing():
    rng = np.random.default_rng(6)
    u = rng.standard_normal(2000)
    omega = np.array([2.0, 5.0])
    spectra = welch.transforms(
        [UniformStretch(np.array([u, 2 * u + rng.standard_normal(2000), u]), 0.1, "")],
        4.0,
        0.0,
        omega,
    )
    few, enough = welch.estimates(spectra, 4.0 * omega)  # 1.3 and 3.2 periods
    assert np.isnan([few.variance, few.dof]).all()
    assert enough == welch.estimate(spectra, 1)
    assert np.isfinite(welch.estimates(spectra, np.array([4 * np.pi, 5.0]))[0].variance)


@pytest.mark.parametrize(("hop", "count"), [(3, 5), (5, 2), (4, 3), (12, 4)])
def test_windows_some_hops_apart_share_what_their_product_holds(hop, count):
    window = np.random.default_rng(0).uniform(0.2, 1, 12)
    placed = np.zeros((count, 12 + hop * count))
    for k in range(count):
        placed[k, hop * k : hop * k + 12] = window
    assert welch.window_correlation(window, hop, count).toarray() == pytest.approx(
        placed @ placed.T
    )


@pytest.mark.parametrize(
    ("overlap", "samples", "begins"),
    [(0.8, 101, range(0, 57, 7)), (0.0, 139, (0, 33, 66, 99)), (0.5, 40, (0,))],
)
def test_windows_hop_through_the_whole_stretch(overlap, samples, begins):
    """Of 40 samples, as many as the overlap asks for at least; the last one begins less than a hop before the end."""
    values = np.zeros((3, samples))
    count, omega = 40, np.array([2.0])
    found = welch.transforms(
        [UniformStretch(values + 1.0, 0.1, "")], 4.0, overlap, omega, taper=False
    )
    at = np.arange(count) * 0.1
    wanted = [0.1 * np.sum(np.exp(-2j * (at + 0.1 * begin))) for begin in begins]
    np.testing.assert_allclose(found.u[:, 0], wanted)


def test_tapers_are_derivatives_of_the_hann_window_by_its_phase():
    one, first, second = welch.hann_tapers(4000, 2)
    step = 2 * np.pi / 4000
    np.testing.assert_allclose(np.gradient(one, step)[1:-1], first[1:-1], atol=1e-5)
    np.testing.assert_allclose(np.gradient(first, step)[1:-1], second[1:-1], atol=1e-5)
    assert one.max() == pytest.approx(1, abs=1e-5)
    assert one[0] == pytest.approx(0, abs=1e-5)
    assert welch.hann_tapers(10, 0).shape == (1, 10)


def spectra_of(x, y, z=None, inputs=1, c=None):
    """One frequency, of uncorrelated windows."""
    z = x if z is None else z
    columns = [[column[:, None] for column in side.T] for side in (x, z)]
    c = np.eye(len(x)) if c is None else c
    return welch.Transforms(x[:, :1], y[:, None], z[:, :1], *columns, csr_array(c), inputs)


@pytest.mark.parametrize(("factor", "weak"), [(0.98, False), (1.02, True)])
def test_an_instrument_is_weak_where_it_explains_less_than_ten_times_the_noise_of_the_input(
    factor, weak
):
    """One instrument r of n windows: |r·u|²/|r|² is what it explains, and the rest over n - 1 the noise."""
    rng = np.random.default_rng(6)
    n = 12
    r, noise = complexes(rng, n), complexes(rng, n)
    noise -= r * np.vdot(r, noise) / np.vdot(r, r)
    size = np.linalg.norm(noise) ** 2 / (n - 1)
    u = noise + r / np.linalg.norm(r) * np.sqrt(10 * size / factor)
    found = welch.estimate(spectra_of(u[:, None], 2 * u + 0.1 * complexes(rng, n), r[:, None]), 0)
    assert found.weak == weak
    assert np.isnan(found.variance) == weak
    # As an input of its own it cannot be weak.
    assert not welch.estimate(spectra_of(u[:, None], complexes(rng, n)), 0).weak


def test_a_variance_takes_three_degrees_of_freedom_and_none_is_below_rounding():
    rng = np.random.default_rng(7)
    for windows, known in ((2, False), (3, True)):
        x = complexes(rng, windows, 1)
        found = welch.estimate(spectra_of(x, complexes(rng, windows)), 0)
        assert np.isfinite(found.variance) == known
    exact = welch.estimate(spectra_of(x, (3 - 4j) * x[:, 0]), 0)
    assert exact.variance == pytest.approx((4 * np.finfo(float).eps * 5) ** 2)
    assert exact.coherence == pytest.approx(1)
    nothing = welch.estimate(
        spectra_of(x, np.array([1.0, -x[0, 0].conj() / x[1, 0].conj(), 0.0])), 0
    )
    assert nothing.coherence == np.finfo(float).eps
    # As many unknowns as windows; leakage that says nothing new is left out.
    assert np.isnan(
        welch.estimate(spectra_of(complexes(rng, 3, 3), complexes(rng, 3), inputs=3), 0).variance
    )
    x, y = complexes(rng, 8, 1), complexes(rng, 8)
    doubled = np.hstack([x, 2 * x])
    assert welch.estimate(spectra_of(doubled, y), 0).response == pytest.approx(
        welch.estimate(spectra_of(x, y), 0).response
    )
    assert np.isnan(welch.estimate(spectra_of(doubled, y, inputs=2), 0).variance)


# --- what is told of all frequencies


def points(*kinds):
    known = [
        welch.WindowedPoint(2.0 + k * 1j, 0.1 * (k + 1), 8.0 + k, 0.5 + 0.1 * k)
        for k in range(len(kinds))
    ]
    other = {"weak": welch.WindowedPoint(weak=True), "lost": welch.WindowedPoint()}
    return [other.get(kind, point) for kind, point in zip(kinds, known, strict=True)]


def test_what_could_be_estimated_is_collected_with_where_it_comes_from():
    omega = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    origin = Stretch("x", 1.0, 2.0)
    stretches = [
        UniformStretch(np.zeros((2, 2)), 0.1, "a.bin", origin, {"u": "N", "y": "", "z": "m"}),
        UniformStretch(np.zeros((2, 2)), 0.1, "b.bin", None, {"y": "m"}),
        UniformStretch(np.zeros((2, 2)), 0.1, "a.bin", origin),
    ]
    found = welch.response_at(
        omega, points("", "weak", "", "lost", "weak"), ("u", "y", "name"), stretches
    )
    np.testing.assert_allclose(found.omega, [1, 3])
    np.testing.assert_allclose(found.response, [2, 2 + 2j])
    np.testing.assert_allclose(found.variance, [0.1, 0.3])
    np.testing.assert_allclose(found.dof, [8, 10])
    np.testing.assert_allclose(found.coherence, [0.5, 0.7])
    assert (found.input, found.output, found.name, found.source) == (
        "u",
        "y",
        "name",
        "a.bin, b.bin",
    )
    assert list(found.stretches) == [origin, origin]
    assert dict(found.units) == {"u": "N"}
    assert found.about == {
        "dropped": "2 of 5 points, where the instrument hardly moves u, at 2 to 5 rad/s"
    }
    one = welch.response_at(omega[:2], points("", "weak"), ("u", "y", ""), [])
    assert one.about == {
        "dropped": "1 of 2 points, where the instrument hardly moves u, at 2 rad/s"
    }
    assert welch.response_at(omega[:2], points("", "lost"), ("u", "y", ""), []).about == {}
    with pytest.raises(ValueError, match="the instrument hardly moves u"):
        welch.response_at(omega[:2], points("weak", "lost"), ("u", "y", ""), [])
    with pytest.raises(
        ValueError, match="no frequency has enough windows for a variance: record longer"
    ):
        welch.response_at(omega[:2], points("lost", "lost"), ("u", "y", ""), [])


def test_points_of_a_coherence_below_six_tenths_are_left_out_unless_all_are():
    omega = np.arange(1.0, 5.0)

    def response(coherence, **about):
        return FrequencyResponse(omega, np.ones(4), coherence=np.array(coherence), about=about)

    left = welch.without_incoherent(response([0.59, 0.6, 0.9, 0.2]))
    assert left.omega.tolist() == [2, 3]
    assert left.about["dropped"] == "2 of 4 points, of a coherence below 0.6, at 1 to 4 rad/s"
    left = welch.without_incoherent(response([0.9, 0.3, 0.9, 0.9], dropped="a", test="b"))
    assert left.about == {
        "dropped": "a; 1 of 4 points, of a coherence below 0.6, at 2 rad/s",
        "test": "b",
    }
    for same in ([0.1, 0.2, 0.3, 0.4], [0.6, 0.7, 0.8, 0.9]):
        whole = response(same)
        assert welch.without_incoherent(whole) is whole


@pytest.mark.parametrize(("apart", "solvable"), [(2.1e-3, True), (1.9e-3, False)])
def test_columns_are_solvable_up_to_a_condition_number_of_a_million(apart, solvable):
    """Of a and a + εb, orthogonal and of length one, the products have 4/ε²."""
    a, b = np.linalg.qr(complexes(np.random.default_rng(0), 6, 2))[0].T
    columns = np.array([a, a + apart * b]).T
    assert welch.solvable(columns, columns) == solvable
