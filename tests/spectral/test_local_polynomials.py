"""Sweeps and noise by local polynomials: independent points, stated variances, and likelihoods that hold."""

from itertools import pairwise

import numpy as np
import pytest
from known_systems import EXAMPLE, LIGHT, MODE, flown, maximum_likelihood
from resonance_records import RATE, covered, flown_sweep, record, resonance
from scipy.signal import freqz, lfilter

from greybox.data.record import Record
from greybox.spectral import local_polynomials
from greybox.spectral.composite_windows import spectral_response
from greybox.spectral.uniform_stretches import UniformStretch


@pytest.mark.parametrize(
    ("system", "excitation", "seed"),
    [(EXAMPLE, "logarithmic", 1), (EXAMPLE, "cifer", 2), (MODE, "noise", 3)],
)
def test_maximum_likelihood_holds(system, excitation, seed):
    """12 records of 164 s with noise of 10 %; 200 of each kind in `benchmarks/spectral_coverage.py`."""
    z = []
    for k in range(12):
        data = spectral_response(
            flown(system, excitation, np.random.default_rng([seed, k])), "u", "y"
        )
        estimate, error = maximum_likelihood(system, data)
        z.append((estimate - system.truth) / error)
    assert np.mean(np.abs(z) < 1.96) >= 0.9
    assert 0.75 < np.sqrt(np.mean(np.square(z))) < 1.25  # 1 ± 0.09 by chance, over all parameters


def test_variances_are_stated_and_neighbors_are_independent():
    """Over 10 records: the squared error is the stated variance, also at the mode, and neighbors have no product."""
    errors = []
    for k in range(10):
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
    assert abs(neighbors) < 0.1  # 400 products


def test_bias_is_far_below_the_noise_at_a_mode():
    """The mean of 25 estimates is within what its own error allows; windows were off by 0.7 of one error."""
    omega = [1.1, 1.45, 1.9]
    truth = EXAMPLE.response(1j * np.array(omega), EXAMPLE.truth)
    z = []
    for k in range(25):
        data = spectral_response(
            flown(EXAMPLE, "logarithmic", np.random.default_rng([9, k])), "u", "y", omega=omega
        )
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
    u, v, *others = rng.standard_normal((2 + inputs, 60)) + 1j * rng.standard_normal(
        (2 + inputs, 60)
    )
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
        np.hstack([*(c[:, None] * powers for c in (first, *others)), *transients])
        for first in (u, r)
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
    np.testing.assert_allclose(
        fitted.weights(omega) @ y, at @ (solution @ y)[: local_polynomials.ORDER + 1]
    )
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
        assert residual.squares == pytest.approx(
            [np.linalg.norm(q @ y) ** 2, np.linalg.norm(q @ u) ** 2], abs=1e-9
        )
        wide = np.zeros((rows.size, 60), dtype=complex)
        wide[:, rows] = q
        whole.append(wide)
    expected = sum(np.linalg.norm(a @ b.conj().T) ** 2 for a in whole for b in whole)
    assert local_polynomials._overlap(found) == pytest.approx(expected)


def test_the_residuals_with_an_instrument_are_those_of_the_response_of_the_nearest_band():
    lines = random_lines(joint=True)
    band = local_polynomials._fit(lines, 20.0, 12.0)
    other = local_polynomials._fit(lines, 32.0, 8.0)
    nearest = local_polynomials.Band(band, np.zeros(0), np.zeros(0), np.zeros(0), None)
    far = nearest._replace(fitted=other)
    found = local_polynomials._residual(lines, 12.0, 7.0, [far, nearest])
    rows, *_ = by_matrices(lines, 12.0, 7.0)
    u, y, *_ = lines.values[:, rows]
    response = band.weights(np.maximum(lines.omega[rows], 8.0)) @ lines.values[1, band.rows]
    known = local_polynomials.Lines(lines.omega, lines.values[[2, 1, 2]], lines.stretch, 1.0, True)
    _, _, _, q = by_matrices(known, 12.0, 7.0)
    squares = [np.linalg.norm(q @ (y - response * u)) ** 2, np.linalg.norm(q @ u) ** 2]
    assert found.squares == pytest.approx(squares)


def test_the_slope_of_noise_is_told_by_many_residuals_and_held_back_of_few():
    centers = np.geomspace(10, 40, 30)

    def residuals(number):
        squares = [number * np.array([c**-1.5, 2 * c**0.5]) for c in centers]
        return [
            local_polynomials._Residual(c, None, s, number, None)
            for c, s in zip(centers, squares, strict=True)
        ]

    many = local_polynomials._slopes(residuals(1e6), 30.0)
    assert many == pytest.approx([-1.5, 0.5], rel=1e-4)
    logs = np.log(centers) - np.log(centers).mean()
    for apart, more in ((30.0, 1.0), (10.0, 3.0)):  # that overlap tell less
        shrunk = logs @ logs / (logs @ logs + np.pi**2 / 6 / 4 * more)
        assert local_polynomials._slopes(residuals(4), apart) == pytest.approx(
            [-1.5 * shrunk, 0.5 * shrunk]
        )


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


# --- which bands


@pytest.mark.parametrize(
    ("limits", "count", "least", "edges"),
    [
        ((1.0, 16.0), 4, 0.0, [1, 2, 4, 8, 16]),
        ((1.0, 16.0), 4, 3.0, [1, 4, 8, 16]),
        (
            (1.0, 10.0),
            9,
            4.0,
            [1, 5, 10],
        ),  # what is left over is too narrow, and goes to the last band
        ((1.0, 9.5), 9, 4.0, [1, 5, 9.5]),
        ((1.0, 3.0), 2, 4.0, [1, 5]),
        ((1.0, 13.0), 9, 4.0, [1, 5, 9, 13]),
    ],
)
def test_bands_have_one_ratio_but_none_is_too_narrow(limits, count, least, edges):
    assert local_polynomials._edges(*limits, count, least) == pytest.approx(edges)


def one_stretch(count=60):
    random = np.random.default_rng(3)
    u, v = random.standard_normal((2, count)) + 1j * random.standard_normal((2, count))
    omega = np.arange(1.0, count + 1)
    return local_polynomials.Lines(
        omega, np.array([u, 2 * u + 0.1 * v, u]), np.zeros(count, dtype=int), 1.0, True
    )


def test_the_narrowest_band_leaves_the_residuals_asked_for_wherever_its_edges_lie():
    """Three coefficients of the response and two of the transient; a band of n lines in width holds n or n + 1."""
    lines = one_stretch()
    for residuals in (1, 2, 3):
        fitted = [
            local_polynomials._fit(lines, 20.0, half, residuals=residuals)
            for half in (2.0, 2.5, 3.0, 3.5, 4.0)
        ]
        sizes = [5, 5, 7, 7, 9]
        assert [f is not None for f in fitted] == [size - 5 >= residuals for size in sizes]
        assert [f.number for f in fitted if f] == [
            size - 5 for size in sizes if size - 5 >= residuals
        ]
        width, left = local_polynomials._narrowest(lines, 20.0, residuals)
        assert (width, left) == (5.0 + residuals, residuals)
    assert local_polynomials._narrowest(lines, 20.0, 1, 0.3) == (
        7.0,
        2,
    )  # 2 of 7 lines for the transient
    with pytest.raises(ValueError, match="too short for any polynomial"):
        local_polynomials._narrowest(lines, 59.0, 3)
    with pytest.raises(ValueError, match="too short for any polynomial"):
        local_polynomials._narrowest(one_stretch(6), 1.0, 3)


def solution_of(lines, center, half, order, slow):
    """From the output to the response's coefficients, and the residuals, of one stretch, written out."""
    rows = np.flatnonzero(np.abs(lines.omega - center) <= half)
    x = (lines.omega[rows] - center) / half
    columns = [lines.values[0, rows, None] * np.vander(x, order + 1, increasing=True)]
    columns = np.hstack([*columns, np.vander(x, slow + 1, increasing=True)])
    return (
        rows,
        np.linalg.pinv(columns)[: order + 1],
        np.eye(rows.size) - columns @ np.linalg.pinv(columns),
    )


def judged(lines, omega=20.0, half=10.0):
    fitted = local_polynomials._fit(lines, 20.0, half)
    return local_polynomials._judged(lines, fitted, np.array([omega]))


def bent(size):
    lines = one_stretch()
    lines.values[1] += size * ((lines.omega - 20.0) / 20.0) ** 3 * lines.values[0]
    return lines


def squared_over_variance(lines, omega):
    """Of the difference of quadratic and quartic in a band twice as wide; and the difference and that variance."""
    found = []
    for order in (2, 4):
        rows, solution, q = solution_of(lines, 20.0, 20.0, order, order - 1)
        found.append((np.vander([(omega - 20.0) / 20.0], order + 1, increasing=True) @ solution, q))
    (wide, _), (finer, q) = found
    y = lines.values[1, rows]
    noise = np.linalg.norm(q @ y) ** 2 / np.trace(q).real
    variance = noise * np.linalg.norm(finer - wide) ** 2
    return abs(((finer - wide) @ y)[0]) ** 2 / variance, abs(((finer - wide) @ y)[0]) ** 2, variance


def test_polynomials_are_wrong_where_a_quartic_differs_by_more_than_noise_explains(monkeypatch):
    monkeypatch.setattr(local_polynomials, "_with_pole", lambda *_: None)
    omega = 26.0
    sizes = np.linspace(0, 3, 400)
    over = np.array([squared_over_variance(bent(size), omega)[0] for size in sizes])
    for threshold, factor, wrong in ((4.6, 0.97, False), (4.6, 1.03, True)):
        size = sizes[np.flatnonzero(over > threshold * factor)[0] - (factor < 1)]
        band, said = judged(bent(size), omega)
        assert said == wrong
        _, squared, variance = squared_over_variance(bent(size), omega)
        expected = (squared - variance) / 16**2 if wrong else 0.0
        assert band.squared_error == pytest.approx([expected], rel=1e-6)
        assert band.pole_noise is None
        assert not band.correction.any()


def test_a_pole_is_looked_for_where_the_polynomials_are_certainly_wrong(monkeypatch):
    omega = 26.0
    monkeypatch.setattr(local_polynomials, "_with_pole", lambda *_: (np.array([0.3j]), (5.0, 4.0)))
    sizes = np.linspace(0, 3, 400)
    over = np.array([squared_over_variance(bent(size), omega)[0] for size in sizes])
    for factor, found in ((0.97, False), (1.03, True)):
        size = sizes[np.flatnonzero(over > 9.2 * factor)[0] - (factor < 1)]
        band, wrong = judged(bent(size), omega)
        assert wrong
        assert (band.pole_noise == (5.0, 4.0)) == found
        assert band.correction == ([0.3j] if found else [0.0])
        assert not found or band.squared_error == pytest.approx([0.01 * 0.3**2])


def test_noise_is_the_mean_of_the_neighborhood_brought_to_the_frequency_of_the_band(monkeypatch):
    """With residuals that do not overlap every one of them counts, twice."""
    asked = []

    def residual(lines, center, half, bands):
        asked.append((center, half))
        at = 2 * len(asked) + np.arange(2)
        squares = 2 * np.array([3.0 * (center / 20.0) ** -1.5, 0.7])
        return local_polynomials._Residual(center, at, squares, 2, np.eye(2, dtype=complex))

    monkeypatch.setattr(local_polynomials, "_residual", residual)
    monkeypatch.setattr(local_polynomials, "STEEP", 1e9)
    lines = one_stretch()._replace(same=False)
    fitted = local_polynomials._fit(one_stretch(), 20.0, 4.0)
    widths = local_polynomials._Widths(point=8.0, noise=6.0, residuals=2)
    band = local_polynomials.Band(fitted, np.zeros(1), np.zeros(1), np.zeros(1), None)
    output, input, dof = local_polynomials._noise(lines, band, [band], widths)
    assert (output, input) == pytest.approx((3.0, 0.7))
    places = 12
    octaves, near = np.array(asked[:places]), np.array(asked[places:])
    np.testing.assert_allclose(octaves[:, 0], np.geomspace(10, 40, places))
    # 8 residuals of two a band are four bands of 6 rad/s, around the center
    np.testing.assert_allclose(near[:, 0], np.linspace(20 - 12 + 3, 20 + 12 - 3, places))
    assert set(np.array(asked)[:, 1]) == {3.0}
    assert dof == pytest.approx(2 * 2 * places)
    with_pole = band._replace(pole_noise=(5.0, 4.0))
    assert local_polynomials._noise(lines._replace(same=True), with_pole, [band], widths) == (
        1.25,
        0.0,
        8.0,
    )
    assert local_polynomials._noise(lines, with_pole, [band], widths) == pytest.approx(
        (1.25, 0.7, 8.0)
    )
    few = band._replace(pole_noise=(5.0, 2.0))
    assert local_polynomials._noise(lines, few, [band], widths)[2] == pytest.approx(4 * places)
    # bands that are visibly wrong do not count: the first reach has none beyond them, so that the
    # next ones are tried
    asked.clear()
    assert local_polynomials._noise(lines, few, [few], widths) is not None
    assert all(abs(center - 20.0) >= 4.0 for center, _ in asked)


# --- from records to lines, and from bands to points


def test_lines_are_transforms_of_whole_stretches_by_frequency():
    """Sums that are written out, whose squares are densities; of 12 and 8 samples, of other steps."""
    rng = np.random.default_rng(0)
    pieces = [
        UniformStretch(rng.standard_normal((3, n)), step, "") for n, step in ((12, 0.05), (8, 0.04))
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
    assert not found.same
    same = [p._replace(values=p.values[[0, 1, 0]]) for p in pieces]
    assert local_polynomials.lines_of(same).same
    assert not local_polynomials.lines_of([same[0], pieces[1]]).same


def quartic(lines, center):
    """Lines whose response is a quartic, without noise: no quadratic holds."""
    lines.values[1] = (1 + ((lines.omega - center) / 10) ** 4) * lines.values[0]
    return lines


@pytest.mark.parametrize(("width", "count"), [(33.2, 4), (31.8, 2), (15.9, 1)])
def test_a_band_is_halved_as_long_as_its_halves_are_no_narrower_than_a_point_needs(width, count):
    center = 26.5
    lines = quartic(one_stretch(), center - 3)
    widths = local_polynomials._Widths(point=8.0, noise=6.0, residuals=1)
    low, high = center - width / 2, center + width / 2
    bands = [b.fitted for b in local_polynomials._halved(lines, low, high, widths)]
    edges = np.linspace(low, high, count + 1)
    np.testing.assert_allclose(
        [(b.center, b.half) for b in bands],
        np.array([edges[1:] + edges[:-1], np.diff(edges)]).T / 2,
    )
    # Where a half leaves no residuals the whole is kept; and so it is where it holds.
    narrow = widths._replace(point=1.0)
    assert len(local_polynomials._halved(lines, 20.0, 33.0, narrow)) == 1
    (kept,) = local_polynomials._halved(one_stretch(), low, high, widths)
    np.testing.assert_allclose(kept.omega, local_polynomials._gauss_nodes(lines, kept.fitted))
    assert local_polynomials._halved(lines, 20.0, 26.0, widths) == []


@pytest.mark.parametrize(
    ("half", "wrong", "taken"), [(20.0, True, 4.0), (6.0, True, 4.0), (20.0, False, 20.0)]
)
def test_a_band_around_a_frequency_is_halved_until_its_polynomials_hold(half, wrong, taken):
    lines = quartic(one_stretch(), 23.0) if wrong else one_stretch()
    widths = local_polynomials._Widths(point=8.0, noise=6.0, residuals=1)
    band = local_polynomials._centered(lines, 26.5, half, widths)
    assert (band.fitted.center, band.fitted.half) == (26.5, taken)
    np.testing.assert_array_equal(band.omega, [26.5])
    assert local_polynomials._centered(lines, 26.5, 3.4, widths) is None


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
    for point, center, half in zip(found, omega, halves, strict=True):
        assert point.response == pytest.approx(
            by_least_squares(lines, center, half, center)[0], rel=1e-9
        )
    assert len(local_polynomials.points_at(lines, np.array([1.0]))) == 1
    lost = local_polynomials.points_at(lines, np.array([204.0, 207.0, 100.0]))
    assert np.isfinite([p.variance for p in lost]).tolist() == [False, False, True]


@pytest.mark.parametrize(("points", "count"), [(15, 5), (1, 1), (4, 1), (5, 2)])
def test_a_smooth_response_has_three_points_in_each_of_the_bands(points, count):
    lines = quiet()
    omega, found = local_polynomials.tiled_points(lines, 30.5, 189.5, points)
    edges = np.geomspace(30.5, 189.5, count + 1)
    assert len(omega) == len(found) == 3 * count
    for k, (low, high) in enumerate(pairwise(edges)):
        own = omega[3 * k : 3 * k + 3]
        assert low < own[0] < own[1] < own[2] < high
        wanted = by_least_squares(lines, (low + high) / 2, (high - low) / 2, own)
        assert [p.response for p in found[3 * k : 3 * k + 3]] == pytest.approx(wanted, rel=1e-9)


def test_an_estimate_is_that_of_its_band_less_what_a_pole_takes_off():
    lines = one_stretch()
    fitted = local_polynomials._fit(lines, 20.0, 8.0)
    omega, correction = np.array([14.0, 21.0]), np.array([0.3j, -0.1])
    band = local_polynomials.Band(fitted, omega, correction, np.array([0.04, 0.01]), (2.0, 5.0))
    widths = local_polynomials._Widths(8.0, 6.0, 1)
    found = local_polynomials._estimates(lines, band, [band], widths)
    rows, solution, _ = solution_of(lines, 20.0, 8.0, 2, 1)
    weights = np.vander((omega - 20.0) / 8.0, 3, increasing=True) @ solution
    wanted = 0.4 * np.sum(np.abs(weights) ** 2, axis=1) + [0.04, 0.01]
    assert [p.response for p in found] == pytest.approx(
        weights @ lines.values[1, rows] - correction
    )
    assert [p.variance for p in found] == pytest.approx(wanted)
    assert [p.dof for p in found] == [10.0, 10.0]
    assert not any(p.weak for p in found)
    exact = band._replace(squared_error=np.zeros(2), pole_noise=(0.0, 5.0))
    for point in local_polynomials._estimates(lines, exact, [exact], widths):
        assert point.variance == pytest.approx((4 * np.finfo(float).eps * abs(point.response)) ** 2)


def test_an_instrument_is_weak_where_the_input_it_explains_is_below_ten_times_its_noise(
    monkeypatch,
):
    """At the middle and the edge of a band, where the polynomials know least; on both sides of it."""
    lines = random_lines(joint=True)
    omega = np.array([20.0, 31.0])
    fitted = local_polynomials._fit(lines, 20.0, 12.0)
    band = local_polynomials.Band(fitted, omega, np.zeros(2, complex), np.zeros(2), None)
    rows, _, solution, _ = by_matrices(lines, 20.0, 12.0)
    weights = np.vander((omega - 20.0) / 12.0, 3, increasing=True) @ solution[:3]
    transients = fitted.transients @ fitted.transients.T
    spread = np.sum(np.abs(weights @ (np.eye(rows.size) - transients)) ** 2, axis=1)
    assert spread[1] > 1.2 * spread[0]
    for noise, weak in (
        (0.098 / spread[1], [False, False]),
        (0.102 / spread[1], [False, True]),
        (0.102 / spread[0], [True, True]),
    ):
        monkeypatch.setattr(local_polynomials, "_noise", lambda *_, noise=noise: (0.1, noise, 8.0))
        found = local_polynomials._estimates(lines, band, [band], None)
        assert [p.weak for p in found] == weak
        assert [np.isnan(p.variance) for p in found] == weak


@pytest.mark.parametrize(("own", "used"), [(2, False), (3, True)])
def test_a_stretch_with_no_more_lines_than_its_transient_has_coefficients_is_left_out(own, used):
    """The long one has lines at whole numbers, the short one so many between them in the band from 12 to 20."""
    extra = 12.5 + np.arange(own)
    omega = np.concatenate([np.arange(1.0, 41.0), [3.5], extra, [25.5]])
    stretch = np.repeat([0, 7], [40, own + 2])
    order = np.argsort(omega)
    lines = local_polynomials.Lines(
        omega[order], np.ones((3, omega.size), complex), stretch[order], 1.0, True
    )
    rows, stretches = local_polynomials._rows(lines, 16.0, 4.0, 1)
    assert stretches == ([0, 7] if used else [0])
    wanted = [*np.arange(12.0, 21.0), *(extra if used else [])]
    np.testing.assert_allclose(lines.omega[rows], np.sort(wanted))


@pytest.mark.parametrize(("apart", "solved"), [(2.2e-6, True), (1.8e-6, False), (0.0, False)])
def test_columns_are_told_apart_up_to_a_condition_number_of_a_million(apart, solved):
    """Of a and a + εb, orthogonal and of length one, it is 2/ε; whatever their units."""
    a, b = np.linalg.qr(np.random.default_rng(0).normal(size=(6, 2)))[0].T
    columns = np.array([1e5 * a, 1e-4 * (a + apart * b)]).T.astype(complex)
    found = local_polynomials._solved(columns, columns)
    assert (found is not None) == solved
    if found:
        np.testing.assert_allclose(columns @ (found[1] @ columns), columns, rtol=1e-6)
    assert local_polynomials._solved(columns * [1, 0], columns) is None
    assert local_polynomials._solved(columns, columns * [1, 0]) is None


@pytest.mark.parametrize(
    ("center", "half", "residuals", "wrong", "near"),
    [
        (
            20.0,
            4.0,
            5,
            (),
            np.linspace(17, 23, 6),
        ),  # two bands of 6 rad/s, and six places in them at least
        (
            20.0,
            4.0,
            1,
            (),
            np.linspace(-1, 41, 24),
        ),  # eight, up to a zero below which there is nothing
        (20.0, 9.0, 5, (), np.linspace(14, 26, 6)),  # a band that is wider itself
        (5.0, 4.0, 5, (), np.linspace(3.5, 9.5, 6)),  # half a line above zero, at least
        (
            20.0,
            4.0,
            5,
            ((20.0, 10.0),),
            np.linspace(3.5, 45.5, 24),
        ),  # four times as far, where all is wrong
        (20.0, 4.0, 5, ((20.0, 2.0),), np.linspace(11, 29, 12)),  # twice as far
        (20.0, 4.0, 5, ((20.0, 1.0),), np.linspace(17, 23, 6)),  # half of the places are enough
        (20.0, 4.0, 5, ((20.0, 40.0),), ()),
    ],
)
def test_noise_comes_from_narrow_bands_nearby_that_are_right(
    monkeypatch, center, half, residuals, wrong, near
):
    asked = []

    def residual(lines, center, half, bands):
        asked.append(center)
        squares = residuals * np.array([3.0, 0.7])
        return local_polynomials._Residual(
            center, 10 * len(asked) + np.arange(2), squares, residuals, np.eye(2) + 0j
        )

    monkeypatch.setattr(local_polynomials, "_residual", residual)
    lines = one_stretch()
    fitted = local_polynomials._fit(lines, 20.0, 6.0)._replace(center=center, half=half)
    band = local_polynomials.Band(fitted, np.zeros(1), np.zeros(1), np.zeros(1), None)
    others = [
        band._replace(fitted=fitted._replace(center=c, half=h), pole_noise=(1.0, 1.0))
        for c, h in wrong
    ]
    widths = local_polynomials._Widths(8.0, 6.0, residuals)
    found = local_polynomials._noise(lines, band, [band, *others], widths)
    places = max(-(-24 // residuals), 6)

    def right(centers):
        return [c for c in centers if all(abs(c - f) >= h for f, h in wrong)]

    octaves = right(np.geomspace(center / 2, 2 * center, places))
    np.testing.assert_allclose(asked[: len(octaves)], octaves)
    if not len(near):
        assert found is None
        return
    low = max(near[0], 3.5)
    wanted = right(low + near - near[0])
    np.testing.assert_allclose(asked[-len(wanted) :], wanted)
    assert found == pytest.approx(
        (3.0, 0.7, 2 * (residuals * len(wanted)) ** 2 / (2 * len(wanted)))
    )


@pytest.mark.parametrize("joint", [False, True])
def test_a_cubic_that_vanishes_at_the_nodes_is_orthogonal_to_all_quadratics(joint):
    """Over the lines of the band, weighted by the amplitudes of input and instrument."""
    lines = random_lines(joint)
    fitted = local_polynomials._fit(lines, 20.0, 9.0)
    nodes = (local_polynomials._gauss_nodes(lines, fitted) - 20.0) / 9.0
    assert np.all(np.abs(nodes) < 1)
    u, _, r, *_ = lines.values[:, fitted.rows]
    x = (lines.omega[fitted.rows] - 20.0) / 9.0
    cubic = np.prod(x[:, None] - nodes, axis=1) * np.abs(u * r)
    np.testing.assert_allclose([cubic @ x**k for k in range(3)], 0, atol=1e-9 * np.abs(cubic).sum())


def test_three_residuals_with_a_pole_tell_the_noise_and_fewer_do_not():
    lines = one_stretch()
    fitted = local_polynomials._fit(lines, 20.0, 4.0)
    band = local_polynomials.Band(fitted, np.zeros(1), np.zeros(1), np.zeros(1), (6.0, 3.0))
    widths = local_polynomials._Widths(8.0, 6.0, 1)
    assert local_polynomials._noise(lines, band, [band], widths) == (2.0, 0.0, 6.0)
    fewer = local_polynomials._noise(lines, band._replace(pole_noise=(6.0, 2.0)), [band], widths)
    assert fewer[0] == pytest.approx(0.02, rel=0.5)  # that of the lines, 0.1² for both components


@pytest.mark.parametrize(("half", "left"), [(3.5, None), (4.0, 1), (4.6, 1), (5.0, 3)])
def test_a_band_with_a_conditioned_input_has_lines_for_its_three_coefficients_too(half, left):
    """Eight unknowns, for as many lines as lie within."""
    lines = one_stretch()
    other = np.random.default_rng(8).standard_normal((2, 60))
    lines = lines._replace(values=np.array([*lines.values, other[0] + 1j * other[1]]))
    fitted = local_polynomials._fit(lines, 20.0, half)
    assert (fitted and fitted.number) == left
