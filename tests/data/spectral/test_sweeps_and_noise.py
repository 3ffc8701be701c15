import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from resonance_records import HZ, RATE, covered, flown_sweep, record, resonance
from scipy.linalg import expm
from scipy.signal import freqz, lfilter

from greybox.data.record import Record
from greybox.data.spectral.sweeps_and_noise import spectral_response


def test_intervals_cover():
    """95 % intervals over 9 records whose output has white noise; the noise is stationary, as the formula assumes."""
    b, a = resonance()
    omega = np.array([2.5, 3.5, 4.5, 7.5, 9.0, 10.5])  # three below and three above the resonance
    rng = np.random.default_rng(1)
    hits = []
    for _ in range(9):
        u = rng.standard_normal(60 * RATE)
        y = lfilter(b, a, u) + 0.1 * rng.standard_normal(u.size)
        got = spectral_response(record(u=u, theta=y), omega=omega)
        hits.append(covered(got, freqz(b, a, omega / RATE)[1]))
    hits = np.concatenate(hits)  # records, frequencies
    assert 0.88 <= hits.mean() <= 1  # 54 intervals: 0.95 ± 0.03 by chance
    for side in (hits[:, :3], hits[:, 3:]):
        assert side.mean() >= 0.85


@settings(max_examples=3, deadline=None)
@given(
    natural=st.floats(3, 12),
    damping=st.floats(0.25, 1.2),
    gain=st.floats(1e-3, 1e3),
    delay=st.integers(0, 3),
)
def test_noise_free_sweep_is_within_two_percent(natural, damping, gain, delay):
    b, a = resonance(natural, damping)
    b = gain * np.concatenate([np.zeros(delay), b])
    u = flown_sweep()
    got = spectral_response(record(u=u, theta=lfilter(b, a, u)), omega=np.geomspace(1.5, 25, 15))
    truth = freqz(b, a, got.omega / RATE)[1]
    assert len(got) == 15
    assert np.abs(got.response / truth - 1).max() < 0.02


def test_default_frequencies_are_the_excited_ones():
    b, a = resonance()
    u = flown_sweep()
    flown = record(
        u=u, theta=lfilter(b, a, u) + 0.02 * np.random.default_rng(0).standard_normal(u.size)
    )
    got = spectral_response(flown, points=25)
    assert 20 <= len(got) <= 60
    assert got.omega[0] < HZ * 0.15
    assert HZ * 4 < got.omega[-1] < HZ * 7.5  # a point or two may drown in the noise


# -- closed loop: the pitch of the simulated vehicle, G(s) = k exp(-sT) / ((tau s + 1) s (s + a)) --
K, TAU, A, DELAY, FAST = 91.0, 0.05, 0.68, 0.0008, 400


def vehicle():
    """Discrete plant x+ = F x + g u + h u_before, exact for a held input with a delay below one step."""
    f = np.array([[0, 1, 0], [0, -A, K], [0, 0, -1 / TAU]])

    def held(seconds):
        both = expm(np.block([[f, np.array([[0], [0], [1 / TAU]])], [np.zeros((1, 4))]]) * seconds)
        return both[:3, :3], both[:3, 3]

    step = 1 / FAST
    rest, new = held(step - DELAY)
    return held(step)[0], new, rest @ held(DELAY)[1]


def vehicle_response(omega):
    f, g, h = vehicle()
    return np.array(
        [np.linalg.solve(z * np.eye(3) - f, g + h / z)[0] for z in np.exp(1j * omega / FAST)]
    )


def fly(injected, torque, seed=0):
    """Closed loop with a colored disturbance torque and gyro noise; (flights, n) at once. Returns u and theta."""
    f, g, h = vehicle()
    rng = np.random.default_rng(seed)
    flights, n = injected.shape
    white = rng.standard_normal((n, flights))
    disturbance = torque * lfilter([math.sqrt(1 - 0.97**2)], [1, -0.97], white, axis=0)
    gyro = 5 * torque * rng.standard_normal((n, flights))
    x, before = np.zeros((3, flights)), np.zeros(flights)
    u, theta = np.empty((2, n, flights))
    for i in range(n):
        theta[i] = x[0]
        u[i] = injected[:, i] - 0.5 * x[0] - 0.12 * (x[1] + gyro[i])
        total = u[i] + disturbance[i]
        x = f @ x + np.outer(g, total) + np.outer(h, before)
        before = total
    return u.T, theta.T


def test_feedback_biases_the_direct_estimate_and_not_the_joint_one():
    """6 sweeps with heavy noise: the direct ratio tends to the controller's inverse, the joint one to the plant."""
    r = np.tile(flown_sweep(FAST, amplitude=0.06), (6, 1))
    u, theta = fly(r, 0.01)
    flown = [record(FAST, u=a, theta=b, r=c) for a, b, c in zip(u, theta, r, strict=True)]
    omega = np.geomspace(1.5, 25, 8)
    truth = vehicle_response(omega)
    direct = spectral_response(flown, omega=omega)
    joint = spectral_response(flown, omega=omega, instrument="r")
    assert np.mean(np.abs(direct.response / truth - 1)) > 0.3
    assert np.mean(covered(direct, truth)) < 0.4
    truth = vehicle_response(joint.omega)
    assert np.mean(np.abs(joint.response / truth - 1)) < 0.12
    assert np.mean(covered(joint, truth)) >= 0.85
    assert np.all(direct.coherence[-2:] > 0.6)  # and a fair coherence is no excuse


def test_where_the_instrument_hardly_moves_the_input_there_is_no_joint_estimate():
    """2 sweeps in a gale: at low frequencies the loop holds the input, and what moves it there is noise."""
    r = np.tile(flown_sweep(FAST, amplitude=0.06), (2, 1))
    standardized = []
    for u, theta, injected in zip(*fly(r, 0.04), r, strict=True):
        flown = record(FAST, u=u, theta=theta, r=injected)
        joint = spectral_response(flown, instrument="r", band=(0.7, 30))
        truth = vehicle_response(joint.omega)
        assert "where the instrument hardly moves u, at 0." in joint.about["dropped"]
        standardized.append(np.abs(joint.response - truth) ** 2 / joint.variance)
    assert 0.7 < np.sqrt(np.mean(np.concatenate(standardized))) < 1.4
    noise = np.random.default_rng(3).standard_normal(theta.size)
    with pytest.raises(ValueError, match="the instrument hardly moves u"):
        spectral_response(
            record(FAST, u=u, theta=theta, r=noise),
            instrument="r",
            omega=[3.0, 6.0],
        )


def test_unstable_plant_without_noise():
    """Sweep of 60 s: stated figure, 0.5 % from 5 to 28 rad/s and 4 % from 1.5 rad/s."""
    r = flown_sweep(FAST, amplitude=0.06)
    u, theta = fly(r[None], 0.0)
    flown = record(FAST, u=u[0], theta=theta[0], r=r)
    for instrument in (None, "r"):
        got = spectral_response(flown, omega=np.geomspace(1.5, 28, 20), instrument=instrument)
        error = np.abs(got.response / vehicle_response(got.omega) - 1)
        assert error.max() < 0.04
        assert error[got.omega > 5].max() < 0.005


def test_gaps_and_missing_samples_split_a_record():
    b, a = resonance()
    rng = np.random.default_rng(4)
    u = rng.standard_normal(120 * RATE)
    y = lfilter(b, a, u)
    hole = y.copy()
    hole[50 * RATE : 50 * RATE + 7] = np.nan
    time = np.arange(u.size) / RATE
    late = np.where(time < 80, time, time + 13.0)
    got = spectral_response(Record(late, {"u": u, "theta": hole}), omega=[3.0, 6.0, 12.0])
    truth = freqz(b, a, got.omega / RATE)[1]
    assert np.abs(got.response / truth - 1).max() < 0.02


def test_more_records_average():
    b, a = resonance()
    rng = np.random.default_rng(5)
    flown = []
    for _ in range(8):
        u = rng.standard_normal(40 * RATE)
        flown.append(record(u=u, theta=lfilter(b, a, u) + 0.5 * rng.standard_normal(u.size)))
    one, many = (spectral_response(r, omega=[4.0, 8.0]) for r in (flown[0], flown))
    assert np.mean(many.variance) < 0.3 * np.mean(one.variance)


def test_second_input_is_conditioned_out():
    """An aileron that moves with the rudder: the plain estimate takes its part along, the partial one does not."""
    b, a = resonance()
    rng = np.random.default_rng(6)
    u = rng.standard_normal(200 * RATE)
    other = 0.7 * u + 0.7 * rng.standard_normal(u.size)
    y = lfilter(b, a, u) + lfilter([0.2], [1, -0.8], other) + 0.05 * rng.standard_normal(u.size)
    flown = record(u=u, other=other, theta=y)
    omega = np.geomspace(2, 20, 8)
    truth = freqz(b, a, omega / RATE)[1]
    plain = spectral_response(flown, omega=omega)
    partial = spectral_response(flown, omega=omega, conditioned=["other"])
    assert np.median(np.abs(plain.response / truth - 1)) > 0.3
    assert np.mean(covered(partial, truth)) >= 0.8
    assert np.abs(partial.response - truth).max() < 0.1
    assert np.all(partial.coherence > 0.6)


def test_inputs_that_feedback_moves_are_estimated_together():
    """Wind moves the output, and both inputs follow: only the injected signals are free of it."""
    rng = np.random.default_rng(8)
    flights = []
    for axis in range(2):
        n = 150 * RATE
        injected = rng.standard_normal((2, n)) * (np.arange(2) == axis)[:, None]
        gust = lfilter([0.3], [1, -0.95], rng.standard_normal(n))
        u, other, y, x = (np.zeros(n) for _ in range(4))
        for k in range(1, n):
            x[k] = 0.9 * x[k - 1] + 0.3 * u[k - 1] + 0.2 * other[k - 1]
            y[k] = x[k] + gust[k]
            u[k] = injected[0, k] - 0.3 * y[k]
            other[k] = injected[1, k] - 0.5 * y[k]
        signals = {"u": u, "other": other, "theta": y, "s": injected[0], "s_other": injected[1]}
        flights.append(record(**signals))
    omega = np.geomspace(2, 20, 8)
    hits = []
    for conditioned in ({"other": "s_other"}, ["other"]):
        got = spectral_response(flights, omega=omega, instrument="s", conditioned=conditioned)
        hits.append(covered(got, freqz([0, 0.3], [1, -0.9], got.omega / RATE)[1]).mean())
    joint, biased = hits
    assert joint >= 0.8
    assert biased <= 0.5


def test_drift_and_trim_do_not_matter():
    b, a = resonance()
    u = flown_sweep()
    y = lfilter(b, a, u)
    plain, moved = (
        spectral_response(
            record(u=u + c, theta=y + c + 0.1 * c * np.linspace(0, 1, u.size)), omega=[3.0, 10.0]
        )
        for c in (0.0, 5.0)
    )
    np.testing.assert_allclose(moved.response, plain.response, rtol=1e-3)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda r: spectral_response(r, omega=[0.01]), "fewer than 6 periods"),
        (lambda r: spectral_response(r, omega=[np.nan]), "omega is nan at index 0"),
        (lambda r: spectral_response(r, omega=[]), "omega has no frequencies: give at least one"),
        (lambda r: spectral_response(r, omega="3"), "omega must be a one-dimensional array"),
        (lambda r: spectral_response("a.csv"), "records is 'a.csv': give a Record or several"),
        (lambda r: spectral_response([r, 3]), "records is 3: give a Record or several"),
        (lambda r: spectral_response(r, "theta"), "theta is the output: name another signal"),
        (lambda r: spectral_response(r, instrument="theta"), "theta is the output"),
        (lambda r: spectral_response(r, conditioned=("theta",)), "theta is the output"),
        (lambda r: spectral_response(r, band=(1e-3, 1e-2)), "not the band from 0.001"),
        (lambda r: spectral_response(r, band=(5.0, 1.0)), "band=5 1 must be two frequencies"),
        (lambda r: spectral_response(r, band="1 5"), "band '1 5' must be a pair of numbers"),
        (lambda r: spectral_response(r, points=0), "points is 0: give a whole number of at least"),
        (lambda r: spectral_response(r, points="9"), "points is '9': give a whole number"),
        (lambda r: spectral_response(r, "v"), "no signal 'v'"),
        (lambda r: spectral_response(r, "still"), "still does not change"),
        (lambda r: spectral_response(r, "missing"), "missing, theta are never all present"),
        (lambda r: spectral_response(r.between(0, 0.1)), "record longer"),
        (lambda r: spectral_response(Record(r.time**1.01, r.signals)), "rate="),
    ],
)
def test_mistakes_are_sentences(call, words):
    rng = np.random.default_rng(0)
    u = rng.standard_normal(30 * RATE)
    flown = record(u=u, theta=u, still=np.ones(u.size), missing=np.full(u.size, np.nan))
    with pytest.raises((ValueError, KeyError, TypeError), match=words):
        call(flown)


def test_a_band_is_kept_to_as_far_as_the_record_resolves_it():
    b, a = resonance()
    u = flown_sweep()
    flown = record(u=u, theta=lfilter(b, a, u))
    got = spectral_response(flown, band=(3.0, 1000.0))
    assert got.omega.min() >= 3.0
    assert got.omega.max() <= 0.4 * HZ * RATE


def test_dropped_points_are_told():
    """Noise in the output drowns the upper frequencies of the sweep."""
    b, a = resonance()
    u = flown_sweep()
    y = lfilter(b, a, u) + 0.5 * np.random.default_rng(0).standard_normal(u.size)
    got = spectral_response(record(u=u, theta=y))
    assert (
        " points, with a coherence below 0.6, or too uncertain at an end, at "
        in got.about["dropped"]
    )
    assert "dropped" not in spectral_response(record(u=u, theta=lfilter(b, a, u))).about


def test_the_grid_reaches_from_six_periods_of_the_record_to_four_tenths_of_the_sampling_rate():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(20 * RATE)
    flown = record(u=u, theta=u + 0.01 * rng.standard_normal(u.size))
    got = spectral_response(flown, band=(1e-3, 1e4), points=12)
    assert 6 * HZ / 20 < got.omega[0] < 9 * HZ / 20
    assert 0.34 * HZ * RATE < got.omega[-1] < 0.4 * HZ * RATE
    assert len(spectral_response(flown, omega=5.0)) == 1


def test_white_noise_excites_all_that_the_record_resolves():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(10 * RATE)
    flown = record(u=u, theta=u + 0.01 * rng.standard_normal(u.size))
    by_excitation = spectral_response(flown, points=12)
    everything = spectral_response(flown, band=(1e-3, 1e4), points=12)
    np.testing.assert_allclose(by_excitation.omega, everything.omega)


def test_the_response_near_the_true_one_is_that_of_the_plant_where_the_input_is_held():
    """A mode of 3 % damping: with the plant itself, nothing of its narrow peak remains."""
    from scipy.signal import cont2discrete

    def plant(omega):
        return 5.0**2 / (5.0**2 - omega**2 + 0.3j * omega)

    b, a, _ = cont2discrete(([5.0**2], [1, 0.3, 5.0**2]), 1 / RATE)  # by a zero-order hold
    u = flown_sweep()
    time = np.arange(u.size) / RATE
    flown = Record(time, {"u": u, "theta": lfilter(b.ravel(), a, u)}, hold={"u": np.inf})
    errors = []
    for near in (None, plant):
        got = spectral_response(flown, near=near).without_hold().between(4.5, 5.5)
        errors.append(np.abs(got.response / plant(got.omega) - 1).max())
    assert errors[1] < 0.01 < errors[0]  # of phase, half a sample of the mode would leave 0.024


def test_a_share_of_what_a_response_near_the_true_one_takes_is_uncertain():
    """Without noise, it is all that is left; the mode has died out before the record ends."""
    b, a = resonance(6.0, 0.05)
    u = np.concatenate([flown_sweep(), np.zeros(20 * RATE)])
    flown = record(u=u, theta=lfilter(b, a, u))
    got = spectral_response(flown, near=lambda w: freqz(b, a, w / RATE)[1]).between(4.5, 8)
    uncertain = np.sqrt(got.variance) / np.abs(got.response)
    assert 1e-3 < uncertain.max() < 0.02
