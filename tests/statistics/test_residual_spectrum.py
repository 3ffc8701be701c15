"""Covariances of estimates whose errors are correlated in time: against dense covariance matrices and Monte Carlo."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm, matmul_toeplitz, solve_discrete_lyapunov, toeplitz
from scipy.signal import lfilter

from greybox.statistics.residual_spectrum import (
    _Grid,
    _Sandwich,
    colored_information,
    score_covariance,
)

AR2 = np.array([1.0, -1.5, 0.7])


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
    return colored_information(weighted, residuals, np.linalg.inv(bread), np.eye(len(residuals[0])))


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
    wanted = colored_information([J], [e], np.linalg.inv(bread), np.eye(2)).meat
    scaled = J / unit[:, None, None]  # R⁻¹ dy/dθ of outputs in other units
    found = colored_information([scaled], [e * unit[:, None]], np.linalg.inv(bread), np.diag(unit**2)).meat
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
        meat = colored_information([J], [residuals], inverse, np.eye(2)).meat
        scaled.append(estimate / np.sqrt(np.diag(inverse @ meat @ inverse)))
    assert np.sqrt(np.mean(np.square(scaled))) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize(("n", "hidden"), [(60, True), (1000, False)])
def test_a_drift_that_a_short_record_hides_is_within_the_limit(n, hidden):
    """What the estimate takes from the drift, by its dense covariance, which the estimated spectrum misses at 60."""
    missed, exceeded, room = 0, 0, []
    slow = 0.4**2 * 0.97 ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    for seed in range(40):
        J, residuals, _ = experiment("drift", n, seed)
        inverse = np.linalg.inv(np.einsum("kpn,kqn->pq", J, J))
        found = colored_information([J], [residuals], inverse, np.eye(2))
        wanted = np.sum(inverse * sum(j @ (slow + np.eye(n)) @ j.T for j in J))
        missed += found.taken < wanted / 1.5
        exceeded += found.taken * found.hidden < wanted / 1.5
        room.append(found.hidden)
    assert (missed > 20) == hidden
    assert exceeded <= 4
    assert (np.median(room) > 1.5**2) == hidden


def test_disagreement_of_the_spectra_makes_the_variance_uncertain():
    """The longer the record, the better the size of slow errors is known."""
    found = []
    for n in (150, 3000):
        each = []
        for seed in range(8):
            J, residuals, _ = experiment("slow", n, seed)
            inverse = np.linalg.inv(np.einsum("kpn,kqn->pq", J, J))
            each.append(colored_information([J], [residuals], inverse, np.eye(2)).uncertainty)
        found.append(np.median(each))
    assert found[0] > 3 * found[1]


def test_a_vector_autoregression_is_among_the_spectra():
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
    found = colored_information([np.zeros((2, 1, 300))], [e], np.eye(1), np.eye(2))
    assert found.meat == 0
    assert found.taken == 0


def test_how_uncertain_the_size_of_slow_errors_is_is_seen_in_repeated_records():
    """White noise hides a drift of a tenth of its power, whose part in the estimates scatters by a factor of 1.7."""
    found = [information([J], [e]) for J, e, _ in (experiment("drift", 300, seed) for seed in range(20))]
    scatter = np.var(np.log([one.taken for one in found]))
    assert 0.4 * scatter < np.mean([one.uncertainty for one in found]) < 2.5 * scatter


def test_the_outputs_of_the_only_record_tell_all_that_there_is_together():
    """In directions of unit variance that is the identity; with as much from other data it is half of it."""
    random = np.random.default_rng(0)
    noise = np.diag([0.04, 9.0])
    slopes = random.normal(size=(2, 3, 200))
    weighted = np.linalg.solve(noise, slopes.reshape(2, -1)).reshape(slopes.shape)
    information = np.einsum("kpn,kqn->pq", weighted, slopes)
    residuals = np.sqrt(np.diag(noise))[:, None] * random.normal(size=(2, 200))
    for share in (1.0, 0.5):
        made = _Sandwich.of([weighted], [residuals], share * np.linalg.inv(information), noise)
        assert_allclose(made.root @ made.root.T, share * np.linalg.inv(information))
        told = [made._not_excluded(i)[0] for i in range(2)]
        assert_allclose(sum(told), share * np.eye(3), atol=1e-9)
        each = [share * np.einsum("pn,qn->pq", weighted[i], slopes[i]) for i in range(2)]
        assert_allclose([np.trace(t) for t in told], [np.trace(np.linalg.solve(information, e)) for e in each])


def test_values_of_bands_are_interpolated_between_their_mean_frequencies():
    grid = _Grid.of(4000)
    omega = 2 * np.pi * np.arange(len(grid.weight)) / grid.size
    assert len(grid.omega) < len(omega) / 4
    values = np.sin(3 * grid.omega) + 2
    assert_allclose(grid.spread_out(values), np.interp(omega, grid.omega, values))
    assert grid.mean(np.ones(len(grid.omega))) == pytest.approx(1)
    # The mean over all frequencies of a slowly changing density is that of its bands.
    assert grid.mean(grid.banded(np.cos(omega) ** 2)) == pytest.approx(0.5, abs=1e-3)


def test_the_covariance_of_another_score_is_that_of_the_spectrum_of_the_errors():
    """Of the same sensitivities that of the estimate itself, and nothing where there are no errors."""
    random = np.random.default_rng(0)
    e = lfilter([1], [1, -0.9], random.normal(size=(2, 400)))
    J = random.normal(size=(2, 3, 400))
    found = colored_information([J], [e], np.linalg.inv(np.einsum("kpn,kqn->pq", J, J)), np.eye(2))
    assert_allclose(score_covariance([J], found.spectrum), found.meat)
    assert np.all(score_covariance([J], None) == 0)


def test_what_is_hidden_is_beside_the_variances_that_are_given():
    """Of one output, which tells all: a fourth of the variances hides four times as much, and none less than one."""
    n = 300
    J = np.vstack([np.ones(n), np.linspace(-1, 1, n)])[None]
    inverse = np.linalg.inv(J[0] @ J[0].T)
    e = colored([1, -0.7], n, seed=3)
    e = (e - e @ J[0].T @ inverse @ J[0])[None]
    sandwich, found = _Sandwich.of([J], [e], inverse, np.eye(1)), information([J], [e])
    hidden = [sandwich.hidden(factor * found.meat, found.spectrum.density) for factor in (1.0, 0.04, 0.01, 1e6)]
    assert hidden[1] > 1
    assert hidden[2] == pytest.approx(4 * hidden[1], rel=1e-6)
    assert hidden[3] == 1


def pushed(n, seed):
    """Position and velocity of a mass on a spring, driven by commands and pushed by noise, under white noise.

    Sensitivities by stiffness, damping and force, those by the initial states, and residuals of a fit of all of them.
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
        J[:, :, t] = F @ J[:, :, t - 1] + np.array([[0.0] * 3, [0.05 * force[t - 1] for force in forces]])
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
        weighted, moved = (c.reshape(2, 100, -1).transpose(0, 2, 1) / [[[1.0]], [[5.0]]] for c in (columns, X))
        for found, more in ((alone, ()), (known, ([moved], lambda jumps=jumps: jumps))):
            meat = colored_information([weighted], [residuals], inverse, noise, *more).meat
            found.append(estimate / np.sqrt(np.diag(inverse @ meat @ inverse)))
    assert np.sqrt(np.mean(np.square(known))) == pytest.approx(1.0, abs=0.25)
    assert np.sqrt(np.mean(np.square(alone))) > 1.5


def test_no_errors_say_nothing_and_hide_nothing():
    random = np.random.default_rng(0)
    found = information([random.normal(size=(2, 3, 50))], [np.zeros((2, 50))])
    assert_allclose(found.meat, np.zeros((3, 3)))
    assert (found.taken, found.uncertainty, found.hidden, found.corrected, found.spectrum) == (0, 0, 1, True, None)
    assert found.correlation_times.tolist() == [0, 0]
    assert_allclose(score_covariance([random.normal(size=(2, 3, 50))], None), np.zeros((3, 3)))
