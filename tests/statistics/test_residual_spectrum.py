"""Covariances of estimates whose errors are correlated in time: against dense covariance matrices and Monte Carlo."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import (
    block_diag,
    expm,
    matmul_toeplitz,
    solve_discrete_lyapunov,
    solve_toeplitz,
    toeplitz,
)
from scipy.signal import lfilter
from unit_directions import by_parameters, of_unit_variance, with_states

from greybox.statistics.averaged_spectrum import AveragedSpectrum, aicc_penalty
from greybox.statistics.colored_information import colored_information
from greybox.statistics.frequency_grid import FrequencyGrid, fast_length
from greybox.statistics.residual_spectrum import (
    BLOCKS,
    ResidualSpectra,
    remaining_products,
    unmasked,
)
from greybox.statistics.variance_components import variance_components

AR2 = np.array([1.0, -1.5, 0.7])


def spectra_of(weighted, residuals, inverse, noise, *states):
    turned = of_unit_variance(weighted, inverse)
    states = with_states(weighted, *states)
    return ResidualSpectra(turned, np.eye(len(inverse)), residuals, noise, *states)


def colored(coefficients, n, seed=0, sigma=1.0):
    white = sigma * np.random.default_rng(seed).normal(size=n + 500)
    return lfilter([1.0], coefficients, white)[500:]


def covariances(coefficients, lags):
    """Of the process with unit innovations, from its impulse response."""
    spectrum = np.abs(np.fft.rfft(lfilter([1.0], coefficients, np.eye(1, 20000)[0]), 40000)) ** 2
    return np.fft.irfft(spectrum)[: lags + 1]


def information(weighted, residuals):
    """For unit noise, the parameters fitted to these data alone."""
    bread = sum(np.einsum("kpn,kqn->pq", J, J) for J in weighted)
    return by_parameters(
        colored_information, weighted, residuals, np.linalg.inv(bread), np.eye(len(residuals[0]))
    )


def test_information_of_outputs_that_hand_their_errors_on():
    """Errors in a position come from those in its velocity: the dense covariance of both."""
    n, random = 1500, np.random.default_rng(3)
    F, C = np.array([[1.0, 0.1], [-0.3, 0.85]]), np.diag([1e-4, 1.0])
    P = solve_discrete_lyapunov(F, C)
    lags, power = [], np.eye(2)
    for _ in range(n):
        lags.append(power @ P)  # E e(t + l) e(t)ᵀ
        power = F @ power
    lags = np.array(lags)
    blocks = [[toeplitz(lags[:, i, j], lags[:, j, i]) for j in range(2)] for i in range(2)]
    J = lfilter([1.0], [1, -0.95], random.normal(size=(2, 2, n)))
    wanted = sum(J[i] @ blocks[i][j] @ J[j].T for i in range(2) for j in range(2))
    found = []
    for seed in range(8):
        white = np.sqrt(np.diag(C))[:, None] * np.random.default_rng(seed).normal(size=(2, n + 300))
        e = np.zeros((2, n + 300))
        for t in range(1, n + 300):
            e[:, t] = F @ e[:, t - 1] + white[:, t]
        found.append(information([J], [e[:, 300:]]).meat)
    assert_allclose(np.diag(np.mean(found, axis=0)), np.diag(wanted), rtol=0.15)


def test_information_is_that_of_the_dense_covariance():
    n, p = 4000, 3
    random = np.random.default_rng(2)
    J = lfilter([1.0], [1, -0.8], random.normal(size=(1, p, n)))
    e = colored(AR2, n, seed=7)
    found = information([J], [e[None]])
    wanted = J[0] @ matmul_toeplitz(covariances(AR2, n - 1), J[0].T)
    assert_allclose(found.meat, wanted, rtol=0.1, atol=0.05 * np.abs(wanted).max())
    assert np.linalg.eigvalsh(found.meat).min() > 0
    assert found.taken == pytest.approx(np.trace(np.linalg.solve(J[0] @ J[0].T, wanted)), rel=0.1)


def test_two_outputs_that_share_their_errors():
    """Vector errors with one color: cross-covariance as the product of both filters."""
    n, p = 4000, 2
    random = np.random.default_rng(4)
    mix = np.array([[1.0, 0.0], [0.8, 0.3]])
    white = mix @ random.normal(size=(2, n + 500))
    e = lfilter([1.0], [1, -0.9], white)[:, 500:]
    J = random.normal(size=(2, p, n)) + 1
    drawn = [matmul_toeplitz(covariances([1, -0.9], n - 1), j.T) for j in J]
    wanted = sum((mix @ mix.T)[i, j] * J[i] @ drawn[j] for i in range(2) for j in range(2))
    assert_allclose(information([J], [e]).meat, wanted, rtol=0.2, atol=0.1 * np.abs(wanted).max())


@pytest.mark.parametrize("kind", ["few", "random", "every fourth", "block"])
def test_missing_samples_do_not_hide_the_color(kind):
    """What is missing has neither residual nor sensitivity; what is there keeps its correlation."""
    n, random = 8000, np.random.default_rng(9)
    there = {
        "random": random.random(n) < 0.5,
        "few": random.random(n) < 0.95,
        "every fourth": np.arange(n) % 4 == 0,
        "block": np.abs(np.arange(n) - n / 2) > n / 5,
    }[kind]
    e = colored([1, -0.9], n, seed=5) * there
    J = (1 + random.normal(size=(1, 2, n))) * there
    wanted = J[0] @ matmul_toeplitz(covariances([1, -0.9], n - 1), J[0].T)
    assert_allclose(np.diag(information([J], [e[None]]).meat), np.diag(wanted), rtol=0.25)


def test_an_output_without_errors_changes_nothing():
    e = np.vstack([colored(AR2, 3000, seed=6), np.zeros(3000)])
    J = np.random.default_rng(0).normal(size=(2, 2, 3000))
    J[1] = 0.0
    assert_allclose(information([J], [e]).meat, information([J[:1]], [e[:1]]).meat, rtol=0.05)


def test_units_of_an_output_do_not_matter():
    e = np.vstack([colored([1, -0.9], 600, seed=1), colored([1, -0.5], 600, seed=2)])
    J = np.random.default_rng(0).normal(size=(2, 2, 600)).cumsum(axis=2)
    unit = np.array([1e-3, 1e4])
    bread = np.einsum("kpn,kqn->pq", J, J)
    wanted = by_parameters(colored_information, [J], [e], np.linalg.inv(bread), np.eye(2)).meat
    scaled = J / unit[:, None, None]  # R⁻¹ dy/dθ of outputs in other units
    found = by_parameters(
        colored_information, [scaled], [e * unit[:, None]], np.linalg.inv(bread), np.diag(unit**2)
    ).meat
    assert_allclose(found, wanted, rtol=1e-9)


def test_stretches_count_together():
    e = colored([1, -0.9], 4000, seed=3)
    J = 1 + np.random.default_rng(1).normal(size=(1, 2, 4000))
    whole = information([J], [e[None]])
    cut = information(np.split(J, 8, axis=2), np.split(e[None], 8, axis=1))
    assert_allclose(cut.meat, whole.meat, rtol=0.1)
    assert cut.correlation_times == pytest.approx(whole.correlation_times, rel=0.3)


def test_the_correlation_time_of_a_slow_error_is_found_under_white_noise():
    """An exponential with a time constant of 30 samples, a fifth of the variance."""
    phi = np.exp(-1 / 30)
    times = []
    for seed in range(6):
        slow = colored([1, -phi], 6000, seed=seed, sigma=np.sqrt(1 - phi**2))
        e = 0.5 * slow + np.random.default_rng(100 + seed).normal(size=6000)
        J = np.random.default_rng(0).normal(size=(1, 2, 6000)).cumsum(axis=2)
        times.append(information([J], [e[None]]).correlation_times[0])
    assert np.median(times) == pytest.approx(30, rel=0.4)


def experiment(kind, n, seed):
    """Two outputs of a lag driven by commands: residuals of a linear fit of three parameters, and its errors."""
    random = np.random.default_rng([seed, n])
    u = np.repeat(random.normal(size=n // 10 + 1), 10)[:n]
    first = lfilter([0.1], [1, -0.9], u)
    second = lfilter([0.1], [1, -0.9], first)
    J = np.zeros((2, 3, n))
    J[0, :2] = first, second
    J[1, 1:] = second, np.ones(n)
    white = random.normal(size=(2, n))
    slow = lfilter([np.sqrt(1 - 0.97**2)], [1, -0.97], random.normal(size=(2, n + 300)))[:, 300:]
    e = {"white": white, "drift": white + 0.4 * slow, "slow": slow}[kind]
    A = J.transpose(0, 2, 1).reshape(-1, 3)
    estimate = np.linalg.lstsq(A, e.ravel(), rcond=None)[0]
    return J, e - np.einsum("kpn,p->kn", J, estimate), estimate


@pytest.mark.parametrize(("kind", "n"), [("white", 150), ("drift", 1000), ("slow", 1000)])
def test_standardized_errors_have_unit_size(kind, n):
    """A drift of 0.4 under white noise of 1 multiplies the variance of what is slow by ten, unseen from lag to lag."""
    scaled = []
    for seed in range(40):
        J, residuals, estimate = experiment(kind, n, seed)
        inverse = np.linalg.inv(np.einsum("kpn,kqn->pq", J, J))
        meat = by_parameters(colored_information, [J], [residuals], inverse, np.eye(2)).meat
        scaled.append(estimate / np.sqrt(np.diag(inverse @ meat @ inverse)))
    assert np.sqrt(np.mean(np.square(scaled))) == pytest.approx(1.0, abs=0.2)


def test_disagreement_of_the_spectra_makes_the_variance_uncertain():
    """The longer the record, the better the size of slow errors is known."""
    found = []
    for n in (150, 3000):
        each = []
        for seed in range(8):
            J, residuals, _ = experiment("slow", n, seed)
            inverse = np.linalg.inv(np.einsum("kpn,kqn->pq", J, J))
            each.append(
                by_parameters(colored_information, [J], [residuals], inverse, np.eye(2)).uncertainty
            )
        found.append(np.median(each))
    assert found[0] > 3 * found[1]


def test_outputs_are_coherent_where_dynamics_pass_their_errors_on():
    """A mass on a spring pushed by noise: the force reaches position through velocity, a quarter period later."""
    F = expm(0.1 * np.array([[0.0, 1.0], [-4.0, -0.8]]))
    n = 3000
    white = np.array([[0.02, 0.0], [0.3, 0.1]]) @ np.random.default_rng(0).normal(size=(2, n))
    e = np.zeros((2, n))
    for t in range(1, n):
        e[:, t] = F @ e[:, t - 1] + white[:, t]
    # A sensitivity that moves like the errors: what both outputs tell is not independent.
    J = np.zeros((2, 1, n))
    for t in range(1, n):
        J[:, 0, t] = F @ J[:, 0, t - 1] + [0.0, np.sin(0.2 * t)]
    response = np.zeros((2, 2, 600))
    response[:, :, 0] = np.eye(2)
    for t in range(1, 600):
        response[:, :, t] = F @ response[:, :, t - 1]
    innovation = white @ white.T / n
    spectrum = np.fft.rfft(response, 8192, axis=2).transpose(2, 0, 1)
    spectrum = spectrum @ innovation @ spectrum.conj().transpose(0, 2, 1)
    transform = np.fft.rfft(J[:, 0], 8192).T
    weight = np.where(np.arange(4097) % 4096 == 0, 1.0, 2.0) / 8192
    wanted = np.einsum("f,fi,fij,fj->", weight, transform.conj(), spectrum, transform).real
    assert_allclose(information([J], [e]).meat[0, 0], wanted, rtol=0.3)


def test_a_record_that_tells_nothing_of_a_parameter_takes_nothing_from_it():
    e = np.random.default_rng(0).normal(size=(2, 300))
    found = by_parameters(colored_information, [np.zeros((2, 1, 300))], [e], np.eye(1), np.eye(2))
    assert found.meat == 0
    assert found.taken == 0


def test_how_uncertain_the_size_of_slow_errors_is_is_seen_in_repeated_records():
    """White noise hides a drift of a tenth of its power, whose part in the estimates scatters by a factor of 1.7."""
    found = [
        information([J], [e]) for J, e, _ in (experiment("drift", 300, seed) for seed in range(20))
    ]
    scatter = np.var(np.log([one.taken for one in found]))
    assert 0.4 * scatter < np.mean([one.uncertainty for one in found]) < 2.5 * scatter


def test_values_of_bands_are_interpolated_between_their_mean_frequencies():
    grid = FrequencyGrid.of(4000)
    omega = 2 * np.pi * np.arange(len(grid.weight)) / grid.size
    assert len(grid.omega) < len(omega) / 4
    values = np.sin(3 * grid.omega) + 2
    assert_allclose(grid.spread_out(values), np.interp(omega, grid.omega, values))
    assert grid.mean(np.ones(len(grid.omega))) == pytest.approx(1)
    # The mean over all frequencies of a slowly changing density is that of its bands.
    assert grid.mean(grid.banded(np.cos(omega) ** 2)) == pytest.approx(0.5, abs=1e-3)


def pushed(n, seed):
    """Position and velocity of a mass on a spring, driven by commands and pushed by noise, under white noise.

    Sensitivities by stiffness, damping and force, those by the initial states, and residuals of a
    fit of all of them.
    """
    F = expm(0.05 * np.array([[0.0, 1.0], [-9.0, -1.2]]))
    random = np.random.default_rng([seed, n])
    u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], n // 10 + 1), 10)[:n]
    x, states, gust, e = np.zeros(2), [], np.zeros(2), np.zeros((2, n))
    for t in range(-300, n):
        if t >= 0:
            states.append(x)
            x = F @ x + [0.0, 0.2 * u[t]]
            e[:, t] = gust + 0.05 * random.normal(size=2)
        gust = F @ gust + [0.0, 0.3 * np.sqrt(0.05) * random.normal()]
    forces = [np.array(states).T[0], np.array(states).T[1], u]
    J, initial = np.zeros((2, 3, n)), np.zeros((2, 2, n))
    initial[:, :, 0] = np.eye(2)
    for t in range(1, n):
        J[:, :, t] = F @ J[:, :, t - 1] + np.array(
            [[0.0] * 3, [0.05 * force[t - 1] for force in forces]]
        )
        initial[:, :, t] = F @ initial[:, :, t - 1]
    A = np.concatenate([J, initial], axis=1).transpose(0, 2, 1).reshape(2 * n, -1)
    weight = np.repeat([1.0, 0.2], n)  # the gusts are in the velocity most
    estimate = np.linalg.lstsq(A * weight[:, None], e.ravel() * weight, rcond=None)[0]
    return J, initial, e - (A @ estimate).reshape(2, n), estimate[:3]


def test_process_noise_is_found_through_the_dynamics_in_a_record_of_three_time_constants():
    """Residuals alone show little of its power: the fit took most, and of the resonance six numbers are left."""
    alone, known = [], []
    for seed in range(15):
        J, initial, residuals, estimate = pushed(100, seed)
        noise = np.diag([1.0, 25.0])
        J, initial = J.copy(), initial.copy()
        jumps = initial.copy()
        for each in (J, initial):
            each[1] /= 5.0
        # The initial states fitted along, and in directions of unit variance.
        X = initial.transpose(0, 2, 1).reshape(-1, 2)
        X = np.linalg.qr(X)[0]
        columns = J.transpose(0, 2, 1).reshape(-1, 3)
        columns = columns - X @ (X.T @ columns)
        inverse = np.linalg.inv(columns.T @ columns)
        weighted, moved = (
            c.reshape(2, 100, -1).transpose(0, 2, 1) / [[[1.0]], [[5.0]]] for c in (columns, X)
        )
        states = {"initial": [moved], "shocks": lambda jumps=jumps: jumps}
        for found, more in ((alone, {}), (known, states)):
            meat = by_parameters(
                colored_information, [weighted], [residuals], inverse, noise, **more
            ).meat
            found.append(estimate / np.sqrt(np.diag(inverse @ meat @ inverse)))
    assert np.sqrt(np.mean(np.square(known))) == pytest.approx(1.0, abs=0.25)
    assert np.sqrt(np.mean(np.square(alone))) > 1.5


def test_no_errors_say_nothing_and_hide_nothing():
    random = np.random.default_rng(0)
    found = information([random.normal(size=(2, 3, 50))], [np.zeros((2, 50))])
    assert_allclose(found.meat, np.zeros((3, 3)))
    assert (found.taken, found.uncertainty, found.corrected, found.spectrum) == (0, 0, True, None)
    assert found.correlation_times.tolist() == [0, 0]


# By dense matrices of few samples.

DEVIATION = np.array([0.3, 5.0])
NOISE = np.array([[0.2, 0.4], [0.4, 9.0]])


def lagged(e, lag, i, j):
    """Σ e_i(t + lag) e_j(t) over stretches, by a loop."""
    return sum(one[i, t + lag] * one[j, t] for one in e for t in range(one.shape[1] - lag))


def small(initial=False, shocks=None, others=0.0, missing=False):
    """Two stretches of 12 and 9 samples, of two outputs, three parameters, and the initial states of each stretch.

    `others` is how much other data tell of the parameters, of what these do.
    """
    random = np.random.default_rng(11)
    there, noise = [np.ones((2, n)) for n in (12, 9)], NOISE
    if missing:
        noise = np.diag(np.diag(NOISE))
        there[0][0, 3:5] = there[0][1, 7] = there[1][1, 2] = 0.0
    weighted = [
        random.normal(size=(2, 3, n)) * t[:, None] for n, t in zip((12, 9), there, strict=True)
    ]
    residuals = [
        DEVIATION[:, None] * random.normal(size=(2, n)) * t
        for n, t in zip((12, 9), there, strict=True)
    ]
    bread = sum(np.einsum("ipn,ij,jqn->pq", W, noise, W) for W in weighted)
    moved = (
        [random.normal(size=(2, 2, t.shape[1])) / 9 * t[:, None] for t in there]
        if initial
        else None
    )
    return spectra_of(
        weighted, residuals, np.linalg.inv(bread) / (1 + others), noise, moved, shocks
    )


def some_density(made):
    """A spectrum of both outputs with phase between them, (k, k, b)."""
    response = np.array(
        [
            [1 + 0.6 * made.grid.delays[1], 0.5 * made.grid.delays[2]],
            [0.3 * made.grid.delays[3], 0.8 + 0j * made.grid.omega],
        ]
    )
    return np.einsum("ikb,jkb->ijb", response, response.conj())


def dense(made, density, stretch):
    """The covariance matrix (2n, 2n) of errors of a density in one stretch, in the outputs' own units."""
    n = made.residuals[stretch].shape[1]
    r = np.fft.irfft(density, made.grid.size)
    blocks = [
        [toeplitz(r[i, j, :n], r[j, i, :n]) * made.deviation[i] * made.deviation[j] for j in (0, 1)]
        for i in (0, 1)
    ]
    return np.block(blocks)


def rows_of(array):
    """(k, p, n) as (k n, p)."""
    return array.transpose(0, 2, 1).reshape(-1, array.shape[1])


def left_by_a_fit(made, density):
    """Covariances of e and of (1 - P) e in every stretch, by dense matrices of all stretches and their parameters."""
    sigma = block_diag(*(dense(made, density, s) for s in (0, 1)))
    W = np.vstack([rows_of(W) for W in made.weighted])
    R = block_diag(*(np.kron(made.noise, np.eye(e.shape[1])) for e in made.residuals))
    P = R @ W @ W.T
    if made.initial[0].size:
        X = block_diag(*(rows_of(X) for X in made.initial))
        P = P + R @ X @ X.T
    there = np.diag(np.concatenate([(e != 0).ravel() for e in made.residuals]).astype(float))
    return there @ sigma @ there, (there - P) @ sigma @ (there - P).T


def lags_of(made, covariance, lag, i, j):
    """Σ_t C[(i, t + lag), (j, t)] over the stretches, in the units of periodograms."""
    total, start = 0.0, 0
    for e in made.residuals:
        n = e.shape[1]
        block = covariance[start : start + 2 * n, start : start + 2 * n].reshape(2, n, 2, n)[
            i, :, j
        ]
        total += np.trace(block, offset=-lag)
        start += 2 * n
    return total / (
        np.sqrt(made.counts[i] * made.counts[j]) * made.deviation[i] * made.deviation[j]
    )


def test_the_periodogram_has_the_autocovariances_of_the_residuals():
    made = small()
    counts = [21, 21]
    size = [np.sqrt(lagged(made.residuals, 0, i, i) / 21) for i in (0, 1)]
    assert_allclose(made.deviation, size)
    assert made.counts.tolist() == counts
    lags, banded = made.periodogram
    assert len(lags) == 6  # four samples for each order
    for lag in range(6):
        for i in (0, 1):
            for j in (0, 1):
                wanted = lagged(made.residuals, lag, i, j) / (21 * size[i] * size[j])
                assert i != j or lags[lag, i] == pytest.approx(wanted, abs=3e-9), (lag, i)
                turned = (banded[i, j] * made.grid.delays[lag].conj()).real
                assert made.grid.mean(turned) == pytest.approx(wanted, abs=3e-9), (lag, i, j)


def test_what_the_estimate_takes_from_errors_is_that_of_dense_matrices():
    made = small()
    density = some_density(made)
    wanted = sum(
        rows_of(W).T @ dense(made, density, s) @ rows_of(W) for s, W in enumerate(made.weighted)
    )
    assert_allclose(made.grid.score_covariance(made.transforms(), density), wanted)
    assert made.taken_by(density) == pytest.approx(np.trace(wanted))


@pytest.mark.parametrize(("initial", "missing"), [(False, False), (True, False), (True, True)])
def test_the_power_that_a_fit_takes_is_that_of_dense_matrices(initial, missing):
    made = small(initial, missing=missing)
    density = some_density(made)
    sigma, left = left_by_a_fit(made, density)
    lags, banded = made.taken_power(made.grid.spread_out(density), made.highest_order)
    for lag in range(len(lags)):
        for i in (0, 1):
            for j in (0, 1):
                wanted = lags_of(made, sigma - left, lag, i, j)
                assert i != j or lags[lag, i] == pytest.approx(wanted, abs=1e-9), (lag, i)
                turned = (banded[i, j] * made.grid.delays[lag].conj()).real
                assert made.grid.mean(turned) == pytest.approx(wanted, abs=1e-9)


def test_other_data_are_taken_to_have_errors_of_the_same_color():
    """White errors three times as large as the given noise: so are the estimate's, whatever tells of it."""
    made = small(others=1.5)
    density = (
        np.repeat(
            (3 * NOISE / np.outer(made.deviation, made.deviation))[:, :, None],
            len(made.grid.omega),
            2,
        )
        + 0j
    )
    lags, _ = made.taken_power(made.grid.spread_out(density), made.highest_order)
    R = block_diag(*(np.kron(NOISE, np.eye(n)) for n in (12, 9)))
    W = np.vstack([rows_of(W) for W in made.weighted])
    taken = 3 * R @ W @ W.T @ R  # P Σ + Σ Pᵀ - P (Σ of all data) Pᵀ
    for lag in (0, 1, 4):
        for i in (0, 1):
            wanted = lags_of(made, taken, lag, i, i)
            assert lags[lag, i] == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("missing", [False, True])
def test_expected_periodograms_are_those_of_residuals_by_dense_matrices(missing):
    jumps = lfilter([1.0], [1, -0.8], np.eye(2)[:, :, None] * np.eye(1, 12)[0]) * [
        [[0.1], [0.3]],
        [[4.0], [1.0]],
    ]
    jumps[1, 0] = np.cumsum(jumps[0, 0])
    made = small(initial=True, shocks=lambda: jumps, missing=missing)
    densities, of_residuals = made.noise_parts(0.0)
    assert len(densities) == 4
    for i in (0, 1):
        assert_allclose(
            densities[i], np.diag(np.eye(2)[i])[:, :, None] * np.ones(len(made.grid.omega))
        )
    for s in (0, 1):  # through each state alone, of one unit of power for each output
        through = np.fft.rfft(jumps[:, s] / made.deviation[:, None], made.grid.size)
        power = np.einsum("ib,jb->ijb", through, through.conj())
        power *= 2 / made.grid.mean(np.einsum("iib->b", power).real)
        assert_allclose(densities[2 + s], power, atol=1e-12)
    for density, found in zip(densities, of_residuals, strict=True):
        _, left = left_by_a_fit(made, density)
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            for lag in (0, 1, 5):
                turned = (found[:, j, i] * made.grid.delays[lag].conj()).real
                assert made.grid.mean(turned) == pytest.approx(
                    lags_of(made, left, lag, i, j), abs=1e-8
                )


def test_process_noise_is_looked_for_where_jumps_move_an_output():
    assert small().noise_parts(0.0) is None
    assert small(shocks=lambda: np.zeros((2, 2, 12))).noise_parts(0.0) is None
    jumps = np.zeros((2, 2, 12))
    jumps[0, 1, 3] = 1.0
    densities, _ = small(shocks=lambda: jumps).noise_parts(0.0)
    assert len(densities) == 3


def test_missing_samples_multiply_covariances_by_their_share():
    """At all lags but zero, of an output; of two outputs at every lag, by the root of both shares."""
    made = small()
    shares = np.array([0.5, 0.8])
    density = some_density(made)
    r = np.fft.irfft(density, made.grid.size)
    masked = r * np.sqrt(np.multiply.outer(shares, shares))[:, :, None]
    masked[[0, 1], [0, 1], 0] = r[[0, 1], [0, 1], 0]
    assert_allclose(unmasked(np.fft.rfft(masked), shares, made.grid), density, atol=1e-12)
    assert unmasked(density, np.array([0.95, 1.0]), made.grid) is density
    assert unmasked(density, np.array([1.0, 0.94]), made.grid) is not density


def test_the_best_lag_tells_which_share_of_the_products_is_left():
    e = np.ones((4, 20))
    e[1, 1::2] = 0.0  # every other one: all products two samples apart
    e[2, 4:] = 0.0  # a shorter record
    e[3] = 0.0
    assert_allclose(remaining_products([e]), [1.0, 1.0, 1.0, 1e-3])
    random = np.where(np.random.default_rng(3).random((1, 4000)) < 0.6, 1.0, 0.0)
    assert remaining_products([random, random[:, :1500]])[0] == pytest.approx(0.6, abs=0.05)
    assert remaining_products([e[:1], e[:1, :7]]).tolist() == [1.0]
    # The distance is beyond all lags of autoregressions.
    slow = np.where(np.arange(1950) % 100 == 0, 1.0, 0.0)[None]
    assert remaining_products([slow, slow[:, :950]]).tolist() == [1.0]


def test_slow_parts_are_exponentials_in_white_noise():
    """Of a circle of samples: covariances share φˡ, wound around it, and the rest of one at lag zero."""
    for n, slowest in ((90, 30.0), (4, 2.0)):
        e = np.ones((1, n))
        made = spectra_of([e[None]], [e], np.eye(1), np.eye(1))
        grid, shapes = made.grid, made.slow.reshape(14, 11, -1)
        for k, share in ((0, 0.01), (4, 0.12), (9, 0.9)):
            for m in (0, 5, 13):
                phi = np.exp(-(slowest ** (-m / 13)))
                for lag in (0, 1, 3):
                    wound = (phi**lag + phi ** (grid.size - lag)) / (1 - phi**grid.size)
                    found = grid.mean(shapes[m, k] * np.cos(lag * grid.omega))
                    assert found == pytest.approx(share * wound + (1 - share) * (lag == 0)), (
                        n,
                        k,
                        m,
                        lag,
                    )


def test_weights_of_frequencies_make_sums_of_squares():
    for n in (5, 24, 900):
        grid = FrequencyGrid.of(n)
        x = np.random.default_rng(0).normal(size=n)
        assert grid.size >= 2 * n
        assert grid.weight @ np.abs(np.fft.rfft(x, grid.size)) ** 2 == pytest.approx(x @ x)
        ends = [*grid.starts[1:], len(grid.weight)]
        omega = np.linspace(0, np.pi, len(grid.weight))
        for start, end, weight, mean in zip(
            grid.starts, ends, grid.band_weight, grid.omega, strict=True
        ):
            assert weight == pytest.approx(grid.weight[start:end].sum())
            assert mean == pytest.approx(
                np.average(omega[start:end], weights=grid.weight[start:end])
            )
            assert end - start <= 0.016 * start + 1
        assert (np.diff(grid.starts) > 0).all()
        if n == 900:
            assert 257 <= len(grid.starts) < 256 + np.log(1024 / 256) / 0.0145


def test_fast_lengths_are_the_next_even_ones_of_few_small_factors():
    fast = sorted(m * 2**k for m in (1, 3, 5, 9, 15) for k in range(1, 13))
    for count in range(1, 1200):
        assert fast_length(count) == next(length for length in fast if length >= count)


def test_outputs_that_share_errors_have_their_coherency_in_every_block():
    """The mean power of a block, divided by the spectra of the outputs; whitened, it has their likelihood."""
    n = 400
    white = np.array([[1.0, 0.0], [0.9, 0.5]]) @ np.random.default_rng(5).normal(size=(2, n))
    J = np.random.default_rng(6).normal(size=(2, 1, n))
    made = spectra_of([J], [white], 1 / np.einsum("kpn,kpn->p", J, J)[:, None], np.eye(2))
    banded = made.periodogram[1]
    flat = np.ones(len(made.grid.omega))
    apart = made.independent_outputs([AveragedSpectrum(flat, 1.0, 0.1, 7.0)] * 2)
    found = made.joint_outputs(apart, banded, 1)
    correlation = np.sum(white[0] * white[1]) / np.sqrt(np.prod(np.sum(white**2, axis=1)))
    assert_allclose(found.density[0, 1].real, correlation, rtol=1e-3)
    assert found.taken == pytest.approx(made.taken_by(found.density))
    size = np.abs(found.density[0, 1, 0])
    assert found.score == pytest.approx(7 + 7 + n * np.log(1 - size**2) + aicc_penalty(2, 2 * n))
    many = made.joint_outputs(apart, banded, 6)
    assert len(np.unique(np.round(many.density[0, 1], 9))) == 6
    assert_allclose(many.density[0, 0], 1.0)


def test_autoregressions_and_slow_parts_of_one_output_are_averaged_by_their_aicc():
    n = 60
    e = lfilter([1, 0.7], [1, -0.6], np.random.default_rng(8).normal(size=(1, n + 50)))[:, 50:]
    J = np.random.default_rng(9).normal(size=(1, 2, n)).cumsum(axis=2)
    made = spectra_of([J], [e], np.linalg.inv(J[0] @ J[0].T), np.eye(1))
    r = made.periodogram[0][:, 0]
    spectra, scores, orders = [], [], [order for order in range(16) if order != 1]
    for order in orders:
        a = np.r_[1, solve_toeplitz(r[:order], -r[1 : order + 1]) if order else []]
        variance = a @ r[: order + 1]
        response = sum(c * np.exp(-1j * k * made.grid.omega) for k, c in enumerate(a))
        spectra.append(variance / np.abs(response) ** 2)
        unknowns = order + 1
        scores.append(
            n * np.log(variance) + 2 * unknowns + 2 * unknowns * (unknowns + 1) / (n - unknowns - 1)
        )
    banded = made.periodogram[1][0, 0].real
    variances = made.grid.mean(banded / made.slow)
    of_slow = n * (np.log(variances) + made.grid.mean(np.log(made.slow)))
    of_slow += 2 * np.log(14 * 11) + aicc_penalty(1, n)
    spectra = np.concatenate([spectra, variances[:, None] * made.slow])
    scores = np.concatenate([scores, of_slow])
    unknowns = np.concatenate([np.array(orders) + 1, np.ones(len(of_slow))])
    weight = np.exp(-0.5 * (scores - scores.min()))
    evidence = scores.min() - 2 * np.log(weight.sum())
    weight /= weight.sum()
    found = made.one_output(0, r, banded)
    assert_allclose(found.density, weight @ spectra, rtol=2e-3)
    assert found.score == pytest.approx(evidence, abs=2e-3)
    taken = np.array([made.taken_by(one[None, None] + 0j) for one in spectra])
    assert found.taken == pytest.approx(weight @ taken, rel=2e-3)
    between = weight @ (np.log(taken) - weight @ np.log(taken)) ** 2
    assert found.uncertainty == pytest.approx(between + weight @ (2 * unknowns / n), rel=5e-3)


def test_correlation_times_are_the_time_constants_of_exponentials():
    grid = FrequencyGrid.of(1000)
    found = grid.correlation_times(
        np.array(
            [
                (1 - p**2) / np.abs(1 - p * np.exp(-1j * grid.omega)) ** 2
                for p in np.exp(-1 / np.array([4.0, 25.0, 9.5])) * [1, 1, -1]
            ]
        )
    )
    # Of the last one, errors alternate in sign.
    assert_allclose(found, [4.0, 25.0, 9.5], atol=1)


def test_long_records_need_few_zeros_against_products_of_their_ends():
    """Offset and trend under errors correlated over a twentieth of the record, against the sums over time."""
    n, phi = 300_000, np.exp(-20 / 300_000)
    grid = FrequencyGrid.of(n)
    assert 1.25 * n <= grid.size < 1.6 * n
    J = np.array([np.ones(n), np.linspace(-1, 1, n)])
    density = (1 - phi**2) / np.abs(1 - phi * np.exp(-1j * grid.omega)) ** 2
    transforms = grid.transform(J[None], np.eye(2), np.ones(1))
    assert_allclose(transforms[0], np.fft.rfft(J, grid.size), rtol=1e-5, atol=1e-6 * n)
    found = grid.score_covariance([transforms], density[None, None].astype(complex))
    past = lfilter([1.0], [1.0, -phi], J, axis=1) @ J.T  # of sums over earlier samples and this one
    assert_allclose(np.diag(found), np.diag(past + past.T - J @ J.T), rtol=0.01)
    assert_allclose(grid.correlation_times(np.array([density])), n / 20, rtol=0.02)


def test_the_penalty_is_that_of_aicc():
    """2 k + 2 k (k + 1) / (n - k - 1), and beyond any score where the unknowns are as many as the numbers."""
    assert aicc_penalty(3, 20) == pytest.approx(6 + 24 / 16)
    assert aicc_penalty(9, 10) == pytest.approx(2 * 9 * 10 / 1e-3)
    assert aicc_penalty(30, 10) > 1e5


def test_outputs_that_are_not_measured_are_left_out_and_have_no_correlation_time():
    n = 80
    random = np.random.default_rng(6)
    J = random.normal(size=(3, 2, n)).cumsum(axis=2)
    e = lfilter([1.0], [1, -0.8], random.normal(size=(3, n)))
    e[1], J[1] = 0.0, 0.0
    noise = np.diag([1.0, 7.0, 4.0])
    J /= np.diag(noise)[:, None, None]
    inverse = np.linalg.inv(sum(noise[i, i] * J[i] @ J[i].T for i in (0, 2)))
    found = by_parameters(colored_information, [J], [e], inverse, noise)
    alone = by_parameters(
        colored_information, [J[[0, 2]]], [e[[0, 2]]], inverse, noise[np.ix_([0, 2], [0, 2])]
    )
    assert_allclose(found.meat, alone.meat)
    assert found.taken == pytest.approx(
        np.trace(np.linalg.solve(np.linalg.inv(inverse), found.meat))
    )
    assert_allclose(
        found.correlation_times, [alone.correlation_times[0], 0, alone.correlation_times[1]]
    )
    assert alone.correlation_times.min() > 0
    assert_allclose(
        found.spectrum.deviation, [np.sqrt(np.mean(e[0] ** 2)), 1, np.sqrt(np.mean(e[2] ** 2))]
    )
    assert not found.spectrum.density[1].any()
    assert_allclose(found.spectrum.density[0, 2], alone.spectrum.density[0, 1])


def slow_and_its_parameter(seed, n=150):
    """One output, one parameter of which slow errors take much: sensitivities, and residuals of its fit."""
    random = np.random.default_rng(seed)
    J = lfilter([1.0], [1, -0.9], random.normal(size=n))
    e = lfilter([1.0], [1, -0.7], random.normal(size=n))
    return J[None], e - J * (J @ e) / (J @ J)


def test_where_a_fit_took_nothing_residuals_say_what_a_periodogram_of_errors_says():
    made = small()
    states = made.initial, made.shocks
    nothing = ResidualSpectra(made.weighted, 0 * made.directions, made.residuals, NOISE, *states)
    # A finite record smears every other spectrum.
    density = np.zeros((2, 2, len(made.grid.omega)), dtype=complex)
    density[[0, 1], [0, 1]] = [[1.2], [0.8]]
    one = AveragedSpectrum(density, 3.0, 0.2, 7.5)
    judged = nothing.judged_on_residuals(one, made.periodogram[1])
    assert judged.score == pytest.approx(
        7.5 + 21 * 2
    )  # of every number, the mean of its square over its variance
    assert judged.density is density
    lags, banded = nothing.taken_power(nothing.grid.spread_out(density), nothing.highest_order)
    assert not lags.any()
    assert not banded.any()


def test_outputs_apart_add_what_they_take_and_its_variance():
    made = small()
    size = len(made.grid.omega)
    alone = [
        AveragedSpectrum(np.full(size, d), taken, u, s)
        for d, s, taken, u in ((2, 11, 3, 0.2), (5, 6, 0.5, 0.7))
    ]
    found = made.independent_outputs(alone)
    assert_allclose(found.density[:, :, 3], [[2, 0], [0, 5]])
    assert (found.score, found.taken) == (17, 3.5)
    assert found.uncertainty == pytest.approx(
        (0.2 * 3**2 + 0.7 * 0.5**2) / 3.5**2
    )  # of the logarithm of the sum


def test_spectra_are_averaged_by_their_evidence():
    made = small()
    lags, banded = made.periodogram
    apart = made.independent_outputs(
        [made.one_output(i, lags[:, i], banded[i, i].real) for i in (0, 1)]
    )
    each = [apart, *(made.joint_outputs(apart, banded, blocks) for blocks in BLOCKS)]
    score = np.array([spectrum.score for spectrum in each])
    share = np.exp(-(score - score.min()) / 2)
    share /= share.sum()
    assert np.sort(share)[-2] > 1e-6
    found = made.others(lags, banded)
    assert_allclose(found.density, np.tensordot(share, [s.density for s in each], 1))
    taken = np.array([spectrum.taken for spectrum in each])
    assert found.taken == pytest.approx(share @ taken)
    between = share @ (np.log(taken) - share @ np.log(taken)) ** 2
    assert found.uncertainty == pytest.approx(apart.uncertainty + between)


def resonant():
    """A mass on a spring: position and velocity, one parameter, and the jumps of both states."""
    n = 60
    F = expm(0.1 * np.array([[0.0, 1.0], [-4.0, -0.8]]))
    random = np.random.default_rng(7)
    e, gust, jumps = np.zeros((2, n)), np.zeros(2), np.zeros((2, 2, n))
    jumps[:, :, 0] = np.eye(2)
    for t in range(1, n):
        jumps[:, :, t] = F @ jumps[:, :, t - 1]
        gust = F @ gust + [0.0, 0.4 * random.normal()]
        e[:, t] = gust
    e += 0.2 * random.normal(size=(2, n))
    J = np.zeros((2, n))
    for t in range(1, n):
        J[:, t] = F @ J[:, t - 1] + [0.0, np.sign(np.sin(0.2 * t))]
    A = J.reshape(-1)
    inverse = 1 / (A @ A)
    e -= J * (A @ e.reshape(-1)) * inverse
    return spectra_of([J[:, None]], [e], np.array([[inverse]]), np.eye(2), None, lambda: jumps)


def test_what_a_fit_took_is_that_of_errors_without_process_noise():
    """An average with process noise would feed the spectra that the fit took most from."""
    made = resonant()
    lags, banded = made.periodogram
    others = made.others(lags, banded)
    for _ in range(2):
        more = made.taken_power(made.grid.spread_out(others.density), made.highest_order)
        corrected = made.others(lags + more[0], banded + more[1])
        changed = abs(corrected.taken - others.taken) >= 0.1 * others.taken
        others = replace(corrected, score=min(others.score, corrected.score))
        if not changed:
            break
    found = colored_information(
        made.weighted, made.directions, made.residuals, made.noise, made.initial, made.shocks
    )
    expected = made.with_process_noise(others)
    assert_allclose(found.spectrum.density, expected.density, rtol=1e-9, atol=1e-12)
    assert expected.taken != pytest.approx(others.taken, rel=1e-6)


def test_process_noise_is_judged_by_the_variances_of_its_parts():
    made = resonant()
    densities, of_residuals = made.noise_parts(0.0)
    found = made.process_noise(0.0)
    power, numbers = made.periodogram[1].T, made.counts[:, None] * made.grid.band_weight
    variance, covariance, score = variance_components(of_residuals, power, numbers, sensors=2)
    assert variance.shape == (4,)
    assert_allclose(
        found.density,
        sum(v * part for v, part in zip(variance, densities, strict=True)),
    )
    assert found.taken == pytest.approx(made.taken_by(found.density))
    assert found.score == pytest.approx(score + 8 + 2 * 4 * 5 / (120 - 5))

    def logarithm(logs):
        return np.log(made.taken_by(np.tensordot(np.exp(logs), densities, 1)))

    logs = np.log(variance)
    slope = np.array([(logarithm(logs + d) - logarithm(logs - d)) / 2e-5 for d in 1e-5 * np.eye(4)])
    assert found.uncertainty == pytest.approx(slope @ covariance @ slope, rel=1e-4)


def test_spectra_are_corrected_for_what_a_fit_took_once_more_where_that_changes_the_variance_by_a_tenth():
    again = []
    for n, slow in ((400, 0.2), (60, 0.95)):
        random = np.random.default_rng(3)
        J = np.vstack([np.ones(n), np.linspace(-1, 1, n)])[None]
        inverse = np.linalg.inv(J[0] @ J[0].T)
        e = lfilter([1.0], [1, -slow], random.normal(size=n))
        e = (e - e @ J[0].T @ inverse @ J[0])[None]
        made = spectra_of([J], [e], inverse, np.eye(1))
        lags, banded = made.periodogram
        mixtures = [made.others(lags, banded)]
        for _ in range(2):
            more = made.taken_power(made.grid.spread_out(mixtures[-1].density), made.highest_order)
            mixtures.append(made.others(lags + more[0], banded + more[1]))
        again.append(abs(mixtures[1].taken / mixtures[0].taken - 1) > 0.1)
        found = by_parameters(colored_information, [J], [e], inverse, np.eye(1))
        assert found.corrected
        assert found.taken == pytest.approx(mixtures[2 if again[-1] else 1].taken)
    assert again == [False, True]


def test_spectra_are_corrected_where_the_fit_took_more_than_it_left():
    n, p = 40, 28
    random = np.random.default_rng(5)
    J = np.linalg.qr(random.normal(size=(n, p)))[0].T[None]
    e = random.normal(size=n)
    found = by_parameters(
        colored_information, [J], [(e - e @ J[0].T @ J[0])[None]], np.eye(p), np.eye(1)
    )
    assert found.corrected
    assert found.taken == pytest.approx(p, rel=0.5)


def test_frequencies_without_power_do_not_make_a_spectrum_infinitely_unlikely():
    J, e = slow_and_its_parameter(0)
    silent = np.fft.irfft(np.fft.rfft(J[0]) * (np.arange(76) < 9), 150)
    made = spectra_of(
        [silent[None, None]], [e[None]], np.array([[1 / (silent @ silent)]]), np.eye(1)
    )
    assert (made.slow > 0).all()
