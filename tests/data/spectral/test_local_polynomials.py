"""Sweeps and noise by local polynomials: independent points, stated variances, and likelihoods that hold."""

from itertools import pairwise

import numpy as np
import pytest
from known_systems import EXAMPLE, LIGHT, MODE, flown, maximum_likelihood
from resonance_records import RATE, covered, flown_sweep, record, resonance
from scipy.signal import freqz, lfilter

from greybox.data.frequency_response import Stretch
from greybox.data.record import Record
from greybox.data.spectral import local_polynomials
from greybox.data.spectral.sweeps_and_noise import spectral_response
from greybox.data.spectral.uniform_stretches import UniformStretch


@pytest.mark.parametrize(
    ("system", "excitation", "seed"),
    [(EXAMPLE, "logarithmic", 1), (EXAMPLE, "cifer", 2), (MODE, "noise", 3)],
)
def test_maximum_likelihood_holds(system, excitation, seed):
    """Four records of 164 s with noise of 10 %; `benchmarks/spectral_coverage.py` has 200 of each kind."""
    z = []
    for k in range(4):
        data = spectral_response(
            flown(system, excitation, np.random.default_rng([seed, k])), "u", "y"
        )
        estimate, error = maximum_likelihood(system, data)
        z.append((estimate - system.truth) / error)
    assert np.mean(np.abs(z) < 1.96) >= 0.85
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.4  # 16 values: 1 ± 0.18 by chance


def test_variances_are_stated_and_neighbors_are_independent():
    """Over 6 records: the squared error is the stated variance, also at the mode, and neighbors have no product."""
    errors = []
    for k in range(6):
        data = spectral_response(
            flown(EXAMPLE, "logarithmic", np.random.default_rng([7, k])), "u", "y"
        )
        e = (data.response - EXAMPLE.response(1j * data.omega, EXAMPLE.truth)) / np.sqrt(
            data.variance
        )
        errors.append((data.omega, e))
    omega, together = (np.concatenate(column) for column in zip(*errors, strict=True))
    assert np.mean(np.abs(together) ** 2) == pytest.approx(1, abs=0.15)
    mode = (omega > 1.0) & (omega < 2.0)
    assert np.mean(np.abs(together[mode]) ** 2) == pytest.approx(1, abs=0.3)
    neighbors = np.mean(np.concatenate([e[1:] * e[:-1].conj() for _, e in errors]))
    assert abs(neighbors) < 0.1  # 240 products


def test_bias_is_far_below_the_noise_at_a_mode():
    """The mean of 12 estimates is within what its own error allows; windows were off by 0.7 of one error."""
    omega = [1.1, 1.45, 1.9]
    truth = EXAMPLE.response(1j * np.array(omega), EXAMPLE.truth)
    z = []
    for k in range(12):
        data = spectral_response(
            flown(EXAMPLE, "logarithmic", np.random.default_rng([9, k])), "u", "y", omega=omega
        )
        z.append((data.response - truth) / np.sqrt(data.variance))
    assert np.all(np.abs(np.mean(z, axis=0)) < 3.2 / np.sqrt(12))


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


def test_intervals_cover_with_colored_noise():
    """95 % intervals of the points, over 4 records of a sweep."""
    pole = 0.95
    b, a = resonance()
    rng = np.random.default_rng(4)
    u = flown_sweep()
    hits = []
    for _ in range(4):
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
    u, v, w, *others = rng.standard_normal((2 + inputs, 60)) + 1j * rng.standard_normal(
        (2 + inputs, 60)
    )
    r = u + 0.3 * w if joint else u
    y = (2 + 0.01 * omega) * u + 0.1 * v
    instruments = [other + 0.3 * w for other in others]
    values = np.array([u, y, r, *others, *instruments])
    return local_polynomials.Lines(omega, values, stretch, 1.0, not joint)


def by_matrices(lines, center, half):
    """Rows, regressors with transients, the way from the output to all coefficients, and that to the residuals."""
    rows = np.flatnonzero(np.abs(lines.omega - center) <= half)
    x = (lines.omega[rows] - center) / half
    powers = np.vander(x, local_polynomials.ORDER + 1, increasing=True)
    slow = np.vander(
        center / lines.omega[rows], local_polynomials.TRANSIENT_ORDER + 1, increasing=True
    )
    transients = [slow * (lines.stretch[rows] == k)[:, None] for k in (0, 1)]
    u, _, r, *others = lines.values[:, rows]
    half = len(others) // 2
    regressors, instruments = (
        np.hstack([*(c[:, None] * powers for c in signals), *transients])
        for signals in ((u, *others[:half]), (r, *others[half:]))
    )
    solution = np.linalg.solve(instruments.conj().T @ regressors, instruments.conj().T)
    return rows, regressors, solution, np.eye(rows.size) - regressors @ solution


@pytest.mark.parametrize(("joint", "inputs"), [(False, 1), (True, 1), (True, 2)])
def test_a_band_is_solved_with_the_transients_of_its_stretches(joint, inputs):
    lines = random_lines(joint, inputs=inputs)
    center, half = 20.0, 9.0
    fitted = local_polynomials.fit_band(lines, center, half)
    rows, _, solution, q = by_matrices(lines, center, half)
    y = lines.values[1, rows]
    omega = np.array([15.0, 22.5])
    at = np.vander((omega - center) / half, local_polynomials.ORDER + 1, increasing=True)
    np.testing.assert_array_equal(fitted.rows, rows)
    np.testing.assert_allclose(
        fitted.weights(omega) @ y, at @ (solution @ y)[: local_polynomials.ORDER + 1]
    )
    np.testing.assert_allclose(fitted.residuals(y), q @ y)
    assert fitted.trace() == pytest.approx(np.trace(q @ q.conj().T).real)
    assert fitted.number == rows.size - len(solution)


def one_stretch(count=60):
    random = np.random.default_rng(3)
    u, v = random.standard_normal((2, count)) + 1j * random.standard_normal((2, count))
    omega = np.arange(1.0, count + 1)
    return local_polynomials.Lines(
        omega, np.array([u, 2 * u + 0.1 * v, u]), np.zeros(count, dtype=int), 1.0, True
    )


def solution_of(lines, center, half, order, slow):
    """From the output to the response's coefficients, and the residuals, of one stretch, written out."""
    rows = np.flatnonzero(np.abs(lines.omega - center) <= half)
    x = (lines.omega[rows] - center) / half
    columns = [lines.values[0, rows, None] * np.vander(x, order + 1, increasing=True)]
    columns = np.hstack(
        [*columns, np.vander(center / lines.omega[rows], slow + 1, increasing=True)]
    )
    return (
        rows,
        np.linalg.pinv(columns)[: order + 1],
        np.eye(rows.size) - columns @ np.linalg.pinv(columns),
    )


# --- from records to lines, and from bands to points


def test_lines_are_transforms_of_whole_stretches_by_frequency():
    """Sums that are written out, whose squares are densities; of 12 and 8 samples, of other steps."""
    rng = np.random.default_rng(0)
    rest = Stretch("", 0.0, 1.0), Record(np.arange(2.0), {"u": np.zeros(2)})
    pieces = [
        UniformStretch(rng.standard_normal((3, n)), step, *rest)
        for n, step in ((12, 0.05), (8, 0.04))
    ]
    found = local_polynomials.lines_of(pieces)
    rows = []
    for index, (values, step, *_) in enumerate(pieces):
        n = values.shape[1]
        for k in range(1, n // 2 + 1):
            omega = 2 * np.pi * k / (n * step)
            rows.append(
                (
                    omega,
                    index,
                    values @ np.exp(-1j * omega * step * np.arange(n)) * np.sqrt(step / n),
                )
            )
    rows.sort(key=lambda row: row[0])
    np.testing.assert_allclose(found.omega, [row[0] for row in rows])
    np.testing.assert_array_equal(found.stretch, [row[1] for row in rows])
    np.testing.assert_allclose(found.values, np.array([row[2] for row in rows]).T, atol=1e-12)
    assert found.spacing == pytest.approx(2 * np.pi / 0.6)
    assert not found.direct
    same = [p._replace(values=p.values[[0, 1, 0]]) for p in pieces]
    assert local_polynomials.lines_of(same).direct
    assert not local_polynomials.lines_of([same[0], pieces[1]]).direct


def quiet():
    """Lines whose noise is too small for polynomials to be judged wrong by chance."""
    lines = one_stretch(200)
    lines.values[1] = 2 * lines.values[0] + 1e-3 * (lines.values[1] - 2 * lines.values[0])
    return lines


def by_least_squares(lines, center, half, omega):
    rows, solution, _ = solution_of(lines, center, half, 2, 1)
    at = np.vander(np.atleast_1d((omega - center) / half), 3, increasing=True)
    return at @ solution @ lines.values[1, rows]


def test_given_frequencies_have_bands_half_way_to_their_neighbors():
    """But a third of their frequency at most, and what a point needs at least; in any order."""
    lines = quiet()
    omega = np.array([100.0, 53.0, 20.0, 50.0, 165.0])
    halves = [23.5, 4.0, 7.0, 4.0, 32.5]
    found = local_polynomials.points_at(lines, omega)
    assert found.omega.tolist() == omega.tolist()
    for response, center, half in zip(found.response, omega, halves, strict=True):
        wanted = by_least_squares(lines, center, half, center)[0]
        assert response == pytest.approx(wanted, rel=1e-9)
    assert local_polynomials.points_at(lines, np.array([1.0])).omega.size == 0
    lost = local_polynomials.points_at(lines, np.array([204.0, 207.0, 100.0]))
    assert lost.omega.tolist() == [100]
    assert np.isfinite(lost.variance).all()


@pytest.mark.parametrize(("points", "count"), [(15, 5), (1, 1), (4, 1), (5, 2)])
def test_a_smooth_response_has_three_points_in_each_of_the_bands(points, count):
    lines = quiet()
    found = local_polynomials.tiled_points(lines, 30.5, 189.5, points)
    edges = np.geomspace(30.5, 189.5, count + 1)
    assert len(found.omega) == len(found.response) == 3 * count
    for k, (low, high) in enumerate(pairwise(edges)):
        own = found.omega[3 * k : 3 * k + 3]
        assert low < own[0] < own[1] < own[2] < high
        wanted = by_least_squares(lines, (low + high) / 2, (high - low) / 2, own)
        assert found.response[3 * k : 3 * k + 3] == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("joint", [False, True])
def test_a_cubic_that_vanishes_at_the_nodes_is_orthogonal_to_all_quadratics(joint):
    """Over the lines of the band, weighted by the amplitudes of input and instrument."""
    lines = random_lines(joint)
    fitted = local_polynomials.fit_band(lines, 20.0, 9.0)
    nodes = (local_polynomials.gauss_nodes(lines, fitted) - 20.0) / 9.0
    assert np.all(np.abs(nodes) < 1)
    u, _, r, *_ = lines.values[:, fitted.rows]
    x = (lines.omega[fitted.rows] - 20.0) / 9.0
    cubic = np.prod(x[:, None] - nodes, axis=1) * np.abs(u * r)
    np.testing.assert_allclose([cubic @ x**k for k in range(3)], 0, atol=1e-9 * np.abs(cubic).sum())


@pytest.mark.parametrize("joint", [False, True])
def test_the_error_of_polynomials_is_that_of_what_a_near_response_leaves(joint):
    """An integrator from its fourth line on, without noise, beside one whose gain is off by 2 %."""
    lines = random_lines(joint)
    lines.values[1] = lines.values[0] / (1j * lines.omega)
    errors = []
    for near in (None, lambda omega: 1.02 / (1j * omega)):
        points = local_polynomials.tiled_points(lines, 4.0, 38.0, 6, near)
        errors.append(np.abs(points.response * 1j * points.omega - 1))
        stated = np.sqrt(points.variance) * points.omega
        assert np.all(errors[-1] <= 10 * stated)
    assert errors[0].max() > 0.002
    assert errors[1].max() < 0.1 * errors[0].max()


@pytest.mark.parametrize("joint", [False, True])
def test_a_pole_inside_a_band_is_estimated_with_the_polynomials(joint):
    """A lightly damped pole that no polynomial of a band follows, in lines without noise."""
    lines = random_lines(joint)
    response = 1 / (1 - (lines.omega / 20.0) ** 2 + 0.2j * lines.omega / 20.0)
    lines.values[1] = response * lines.values[0]
    omega = np.array([19.0])
    found = local_polynomials.points_at(lines, omega)
    truth = 1 / (1 - (omega / 20.0) ** 2 + 0.2j * omega / 20.0)
    (plain,) = (
        by_matrices(lines, 19.0, 6.65)[2][:1] @ lines.values[1, np.abs(lines.omega - 19.0) <= 6.65]
    )
    assert abs(found.response[0] / truth[0] - 1) < 0.2 * abs(plain / truth[0] - 1)


def test_variances_do_not_favor_points_that_feedback_made_strong():
    """A gain of 2 in a loop, u = (r - v) / 3: a mean of points by their variances is off by chance alone."""
    rng, count = np.random.default_rng(0), 2000
    r = np.exp(2j * np.pi * rng.random(count))
    v = 0.5 * (rng.standard_normal((count, 2)) @ [1, 1j]) / np.sqrt(2)
    u = (r - v) / 3
    lines = local_polynomials.Lines(
        np.arange(1.0, count + 1),
        np.array([u, 2 * u + v, r]),
        np.zeros(count, dtype=int),
        1.0,
        False,
    )
    points = local_polynomials.points_at(lines, np.arange(20.0, count - 10, 10.0))
    error, weight = (points.response - 2)[~points.weak], 1 / points.variance[~points.weak]
    assert len(weight) > 0.9 * len(points.weak)
    assert np.mean(np.abs(error) ** 2 * weight) == pytest.approx(1, abs=0.35)
    # By the own strength of the points, the mean is off by -6.4 standard errors.
    assert abs(weight @ error.real) < 2.5 * np.sqrt(weight.sum() / 2)


def test_variances_hold_where_the_input_has_peaks():
    """A gain from instrument to input with peaks of 16: neighbors expect less, by more than chance."""
    rng, count = np.random.default_rng(0), 3000
    omega, peaks = np.arange(1.0, count + 1), np.arange(200.0, count - 100, 100.0)
    gain = 1 + 15 * np.exp(-0.5 * ((omega[:, None] - peaks) / 10) ** 2).sum(axis=1)
    r = np.exp(2j * np.pi * rng.random(count))
    v = (rng.standard_normal((count, 2)) @ [1, 1j]) / np.sqrt(2)
    u = (gain * r - v) / 3
    lines = local_polynomials.Lines(
        omega, np.array([u, 2 * u + v, r]), np.zeros(count, dtype=int), 1.0, False
    )
    points = local_polynomials.points_at(lines, np.arange(50.0, count - 60, 25.0))
    at_peak = np.isin(points.omega, peaks)
    squared = np.abs(points.response[at_peak] - 2) ** 2 / points.variance[at_peak]
    assert squared.mean() == pytest.approx(1, abs=0.35)
