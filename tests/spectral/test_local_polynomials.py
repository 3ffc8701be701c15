"""Sweeps and noise by local polynomials: independent points, stated variances, and likelihoods that hold."""

import numpy as np
import pytest
from known_systems import EXAMPLE, LIGHT, MODE, flown, maximum_likelihood
from resonance_records import RATE, covered, flown_sweep, record, resonance
from scipy.signal import freqz, lfilter

from greybox.data.record import Record
from greybox.spectral import local_polynomials
from greybox.spectral.composite_windows import spectral_response


@pytest.mark.parametrize(
    ("system", "excitation", "seed"), [(EXAMPLE, "logarithmic", 1), (EXAMPLE, "cifer", 2), (MODE, "noise", 3)]
)
def test_maximum_likelihood_holds(system, excitation, seed):
    """12 records of 164 s with noise of 10 %; 200 of each kind in `benchmarks/spectral_coverage.py`."""
    z = []
    for k in range(12):
        data = spectral_response(flown(system, excitation, np.random.default_rng([seed, k])), "u", "y")
        estimate, error = maximum_likelihood(system, data)
        z.append((estimate - system.truth) / error)
    assert np.mean(np.abs(z) < 1.96) >= 0.9
    assert 0.75 < np.sqrt(np.mean(np.square(z))) < 1.25  # 1 ± 0.09 by chance, over all parameters


def test_variances_are_stated_and_neighbors_are_independent():
    """Over 10 records: the squared error is the stated variance, also at the mode, and neighbors have no product."""
    errors = []
    for k in range(10):
        data = spectral_response(flown(EXAMPLE, "logarithmic", np.random.default_rng([7, k])), "u", "y")
        e = (data.response - EXAMPLE.response(1j * data.omega, EXAMPLE.truth)) / np.sqrt(data.variance)
        errors.append((data.omega, e))
    omega, together = (np.concatenate(column) for column in zip(*errors, strict=True))
    assert np.mean(np.abs(together) ** 2) == pytest.approx(1, abs=0.15)
    mode = (omega > 1.0) & (omega < 2.0)
    assert np.mean(np.abs(together[mode]) ** 2) == pytest.approx(1, abs=0.3)
    neighbors = np.mean(np.concatenate([e[1:] * e[:-1].conj() for _, e in errors]))
    assert abs(neighbors) < 0.1  # 400 products


def test_bias_is_far_below_the_noise_at_a_mode():
    """The mean of 25 estimates is within what its own error allows; windows were off by 0.7 of one error."""
    omega = [1.1, 1.45, 1.9]
    truth = EXAMPLE.response(1j * np.array(omega), EXAMPLE.truth)
    z = []
    for k in range(25):
        data = spectral_response(flown(EXAMPLE, "logarithmic", np.random.default_rng([9, k])), "u", "y", omega=omega)
        z.append((data.response - truth) / np.sqrt(data.variance))
    assert np.all(np.abs(np.mean(z, axis=0)) < 3.2 / np.sqrt(25))


def test_a_mode_that_the_record_hardly_resolves():
    """Damped by 0.03 at 3 rad/s in 164 s, without noise: a pole takes off what the polynomials miss."""
    flight = flown(LIGHT, "noise", np.random.default_rng(0), noise=0.0)
    data = spectral_response(flight, "u", "y")
    truth = LIGHT.response(1j * data.omega, LIGHT.truth)
    assert np.abs(data.response / truth - 1).max() < 0.02


def test_points_are_fewer_than_asked_where_the_record_does_not_resolve_them():
    """A band of three points needs eight lines."""
    flight = flown(EXAMPLE, "cifer", np.random.default_rng(0))
    data = spectral_response(flight, "u", "y", points=400)
    lines = (data.omega.max() - data.omega.min()) * 164 / (2 * np.pi)
    assert 0.2 * lines < len(data) <= 3 / 8 * lines + 3


def test_gauss_nodes_of_even_excitation_are_those_of_legendre():
    n = 400
    omega = np.arange(1.0, n + 1)
    values = np.ones((3, n), complex)
    lines = local_polynomials.Lines(omega, values, np.zeros(n, dtype=int), 1.0, True)
    rows = np.arange(100, 201)
    x = (omega[rows] - 151.0) / 50.5
    empty = np.zeros((101, 0), complex)
    band = local_polynomials.Fitted(151.0, 50.5, rows, x, empty, empty, empty.T, empty.real, 2)
    nodes = (local_polynomials._gauss_nodes(lines, band) - 151.0) / 50.5
    np.testing.assert_allclose(nodes, np.polynomial.legendre.leggauss(3)[0], atol=2e-3)


@pytest.mark.parametrize("pole", [0.0, 0.95])
def test_intervals_cover_with_colored_noise(pole):
    """95 % intervals of the points, over 6 records of a sweep."""
    b, a = resonance()
    rng = np.random.default_rng(4)
    u = flown_sweep()
    hits = []
    for _ in range(6):
        noise = lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.standard_normal(u.size + 200))[200:]
        got = spectral_response(record(u=u, theta=lfilter(b, a, u) + 0.1 * noise))
        hits.append(covered(got, freqz(b, a, got.omega / RATE)[1]).mean())
    assert 0.91 <= np.mean(hits) <= 0.985


def test_many_short_stretches():
    """40 stretches of 8 s, as a log with gaps has them."""
    b, a = resonance()
    rng = np.random.default_rng(8)
    u = rng.standard_normal(320 * RATE)
    y = lfilter(b, a, u) + 0.1 * rng.standard_normal(u.size)
    time = np.arange(u.size) / RATE
    time = time + np.floor(time / 8)
    got = spectral_response(Record(time, {"u": u, "theta": y}))
    truth = freqz(b, a, got.omega / RATE)[1]
    assert len(got) >= 9  # from 6 periods in a stretch to where the output drowns
    assert 0.88 <= np.mean(covered(got, truth)) <= 1
    assert np.median(np.abs(got.response / truth - 1)) < 0.05


# --- one band, by matrices that are written out


def random_lines(joint, seed=0, inputs=1):
    """Lines of two stretches, of which the second has every other frequency; noise beside a smooth response."""
    rng = np.random.default_rng(seed)
    long, short = np.arange(1.0, 41.0), np.arange(2.0, 41.0, 2.0)
    omega, stretch = np.concatenate([long, short]), np.repeat([0, 1], [40, 20])
    order = np.argsort(omega, kind="stable")
    omega, stretch = omega[order], stretch[order]
    u, v, *others = rng.standard_normal((2 + inputs, 60)) + 1j * rng.standard_normal((2 + inputs, 60))
    r = u + 0.3 * others[0] if joint else u
    y = (2 + 0.01 * omega) * u + 0.1 * v
    return local_polynomials.Lines(omega, np.array([u, y, r, *others[1:]]), stretch, 1.0, not joint)


def by_matrices(lines, center, half):
    """Rows, regressors with transients, the way from the output to all coefficients, and that to the residuals."""
    rows = np.flatnonzero(np.abs(lines.omega - center) <= half)
    x = (lines.omega[rows] - center) / half
    powers = np.vander(x, local_polynomials.ORDER + 1, increasing=True)
    slow = np.vander(x, local_polynomials.TRANSIENT_ORDER + 1, increasing=True)
    transients = [slow * (lines.stretch[rows] == k)[:, None] for k in (0, 1)]
    u, _, r, *others = lines.values[:, rows]
    regressors, instruments = (
        np.hstack([*(c[:, None] * powers for c in (first, *others)), *transients]) for first in (u, r)
    )
    solution = np.linalg.solve(instruments.conj().T @ regressors, instruments.conj().T)
    return rows, regressors, solution, np.eye(rows.size) - regressors @ solution


@pytest.mark.parametrize(("joint", "inputs"), [(False, 1), (True, 1), (True, 2)])
def test_a_band_is_solved_with_the_transients_of_its_stretches(joint, inputs):
    lines = random_lines(joint, inputs=inputs)
    center, half = 20.0, 9.0
    fitted = local_polynomials._fit(lines, center, half)
    rows, _, solution, q = by_matrices(lines, center, half)
    y = lines.values[1, rows]
    omega = np.array([15.0, 22.5])
    at = np.vander((omega - center) / half, local_polynomials.ORDER + 1, increasing=True)
    np.testing.assert_array_equal(fitted.rows, rows)
    np.testing.assert_allclose(fitted.weights(omega) @ y, at @ (solution @ y)[: local_polynomials.ORDER + 1])
    np.testing.assert_allclose(fitted.residuals(y), q @ y)
    assert fitted.trace() == pytest.approx(np.trace(q @ q.conj().T).real)
    assert fitted.number == rows.size - len(solution)


def test_what_is_left_in_narrow_bands_counts_as_often_as_they_overlap():
    lines = random_lines(joint=False)
    found = [local_polynomials._residual(lines, center, 7.0, []) for center in (14.0, 18.0, 33.0)]
    whole = []
    for residual, center in zip(found, (14.0, 18.0, 33.0), strict=True):
        rows, _, solution, q = by_matrices(lines, center, 7.0)
        u, y = lines.values[:2, rows]
        assert residual.number == rows.size - len(solution)
        assert residual.squares == pytest.approx([np.linalg.norm(q @ y) ** 2, np.linalg.norm(q @ u) ** 2], abs=1e-9)
        wide = np.zeros((rows.size, 60), dtype=complex)
        wide[:, rows] = q
        whole.append(wide)
    expected = sum(np.linalg.norm(a @ b.conj().T) ** 2 for a in whole for b in whole)
    assert local_polynomials._overlap(found) == pytest.approx(expected)


def test_the_residuals_with_an_instrument_are_those_of_the_response_of_the_nearest_band():
    lines = random_lines(joint=True)
    band = local_polynomials._fit(lines, 20.0, 15.0)
    other = local_polynomials._fit(lines, 32.0, 8.0)
    nearest = local_polynomials.Band(band, np.zeros(0), np.zeros(0), np.zeros(0), None)
    far = nearest._replace(fitted=other)
    found = local_polynomials._residual(lines, 12.0, 7.0, [far, nearest])
    rows, *_ = by_matrices(lines, 12.0, 7.0)
    u, y, *_ = lines.values[:, rows]
    response = band.weights(np.maximum(lines.omega[rows], 5.0)) @ lines.values[1, band.rows]
    known = local_polynomials.Lines(lines.omega, lines.values[[2, 1, 2]], lines.stretch, 1.0, True)
    _, _, _, q = by_matrices(known, 12.0, 7.0)
    squares = [np.linalg.norm(q @ (y - response * u)) ** 2, np.linalg.norm(q @ u) ** 2]
    assert found.squares == pytest.approx(squares)


def test_the_slope_of_noise_is_told_by_many_residuals_and_held_back_of_few():
    centers = np.geomspace(10, 40, 30)

    def residuals(number):
        squares = [number * np.array([c**-1.5, 2 * c**0.5]) for c in centers]
        return [local_polynomials._Residual(c, None, s, number, None) for c, s in zip(centers, squares, strict=True)]

    many = local_polynomials._slopes(residuals(1e6), 30.0)
    assert many == pytest.approx([-1.5, 0.5], rel=1e-4)
    logs = np.log(centers) - np.log(centers).mean()
    for apart, more in ((30.0, 1.0), (10.0, 3.0)):  # that overlap tell less
        shrunk = logs @ logs / (logs @ logs + np.pi**2 / 6 / 4 * more)
        assert local_polynomials._slopes(residuals(4), apart) == pytest.approx([-1.5 * shrunk, 0.5 * shrunk])


@pytest.mark.parametrize("joint", [False, True])
def test_a_pole_in_a_band_is_taken_off(joint):
    """Of lines without noise the response is that of the polynomials over the pole, and nothing is left."""
    lines = random_lines(joint)
    center, half = 20.0, 8.0
    x = (lines.omega - center) / (2 * half)
    u = lines.values[0]
    response = (2 + (0.3 - 0.2j) * x + 0.1 * x**2) / (1 + (0.5 - 0.4j) * x)
    transient = (0.2 - 0.1 * x) / (1 + (0.5 - 0.4j) * x) * np.where(lines.stretch == 0, 1, -2)
    lines.values[1] = response * u + transient
    fitted = local_polynomials._fit(lines, center, half)
    omega = np.array([15.0, 20.0, 26.0])
    correction, (left, number) = local_polynomials._with_pole(lines, fitted, omega)
    at = (omega - center) / (2 * half)
    truth = (2 + (0.3 - 0.2j) * at + 0.1 * at**2) / (1 + (0.5 - 0.4j) * at)
    polynomials = fitted.weights(omega) @ lines.values[1, fitted.rows]
    assert np.abs(polynomials / truth - 1).max() > 1e-4
    np.testing.assert_allclose(polynomials - correction, truth, rtol=1e-9)
    assert left == pytest.approx(0, abs=1e-18)
    assert number == np.sum(np.abs(x) <= 1) - (local_polynomials.ORDER + 2) - 2 * (
        local_polynomials.TRANSIENT_ORDER + 1
    )


@pytest.mark.parametrize("joint", [False, True])
def test_coherence_is_the_share_that_the_instrument_explains(joint):
    lines = random_lines(joint, inputs=2)
    lines.values[1] += 0.5 * (np.random.default_rng(1).standard_normal((2, 60)).T @ [1, 1j])
    fitted = local_polynomials._fit(lines, 20.0, 9.0)
    rows, regressors, *_ = by_matrices(lines, 20.0, 9.0)
    u, y, r, _ = lines.values[:, rows]
    split = local_polynomials.ORDER + 1

    def unexplained(signal, columns):
        left = signal - columns @ np.linalg.lstsq(columns, signal, rcond=None)[0]
        return np.linalg.norm(left) ** 2 / (rows.size - columns.shape[1])

    rest = regressors[:, split:]
    powers = np.vander((lines.omega[rows] - 20.0) / 9.0, split, increasing=True)
    everything = np.hstack([r[:, None] * powers, rest])
    noise = 0.123
    if joint:
        expected = 1 - max(unexplained(s, everything) / unexplained(s, rest) for s in (u, y))
    else:
        expected = 1 - noise / unexplained(y, rest)
    assert local_polynomials._coherence(lines, fitted, noise) == pytest.approx(expected)
    assert 0.1 < expected < 1
