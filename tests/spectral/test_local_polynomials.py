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
    """Over 15 records: the squared error is the stated variance, also at the mode, and neighbors have no product."""
    errors = []
    for k in range(15):
        data = spectral_response(flown(EXAMPLE, "logarithmic", np.random.default_rng([7, k])), "u", "y")
        e = (data.response - EXAMPLE.response(1j * data.omega, EXAMPLE.truth)) / np.sqrt(data.variance)
        errors.append((data.omega, e))
    omega, together = (np.concatenate(column) for column in zip(*errors, strict=True))
    assert np.mean(np.abs(together) ** 2) == pytest.approx(1, abs=0.15)
    mode = (omega > 1.0) & (omega < 2.0)
    assert np.mean(np.abs(together[mode]) ** 2) == pytest.approx(1, abs=0.3)
    neighbors = np.mean(np.concatenate([e[1:] * e[:-1].conj() for _, e in errors]))
    assert abs(neighbors) < 0.1  # 600 products


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
    """95 % intervals of the points, over 10 records of a sweep."""
    b, a = resonance()
    rng = np.random.default_rng(4)
    u = flown_sweep()
    hits = []
    for _ in range(10):
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
