import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from resonance_records import HZ, RATE, covered, flown_sweep, record, resonance
from scipy.linalg import expm
from scipy.signal import freqz, lfilter

from greybox.data.record import Record
from greybox.spectral import composite_windows
from greybox.spectral.composite_windows import spectral_response
from greybox.spectral.uniform_stretches import UniformStretch


@pytest.mark.parametrize(("kind", "windows"), [("noise", [12.0]), ("noise", None), ("sweep", None)])
def test_intervals_cover(kind, windows):
    """95 % intervals over 30 records whose output has white noise; the noise is stationary, as the formula assumes."""
    b, a = resonance()
    omega = np.array([2.5, 3.5, 4.5, 7.5, 9.0, 10.5])  # three below and three above the resonance
    rng = np.random.default_rng(1)
    hits = []
    for _ in range(30):
        u = rng.standard_normal(60 * RATE) if kind == "noise" else flown_sweep()
        y = lfilter(b, a, u) + 0.1 * rng.standard_normal(u.size)
        got = spectral_response(record(u=u, theta=y), omega=omega, windows=windows)
        hits.append(covered(got, freqz(b, a, omega / RATE)[1]))
    hits = np.concatenate(hits)  # records, frequencies
    assert 0.92 <= hits.mean() <= 0.97
    for side in (hits[:, :3], hits[:, 3:]):
        assert 0.88 <= side.mean() <= 0.985


@settings(max_examples=8, deadline=None)
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


def test_a_sharp_resonance_takes_the_long_windows():
    """A 4 % damped mode: the short window alone is wrong by half, the combination hardly."""
    b, a = resonance(6.0, 0.04)
    rng = np.random.default_rng(0)
    u = rng.standard_normal(300 * RATE)
    flown = record(u=u, theta=lfilter(b, a, u))
    omega = [5.6, 5.8, 6.0, 6.2, 6.4]
    truth = freqz(b, a, np.array(omega) / RATE)[1]
    short, both = (
        np.abs(spectral_response(flown, omega=omega, windows=w).response / truth - 1)
        for w in ([5.0], [5.0, 60.0])
    )
    assert short.max() > 0.3
    assert both.max() < 0.03


def test_leakage_terms_take_most_of_the_bias(monkeypatch):
    b, a = resonance(3.0, 0.25)
    u = flown_sweep()
    flown = record(u=u, theta=lfilter(b, a, u))
    omega = np.geomspace(1.5, 25, 15)
    windows = np.geomspace(22, 2.75, 5)
    errors = []
    for order in (0, 2):
        monkeypatch.setattr(composite_windows, "LEAKAGE_TERMS", order)
        got = spectral_response(flown, omega=omega, windows=windows)
        errors.append(np.abs(got.response / freqz(b, a, omega / RATE)[1] - 1))
    assert errors[0].max() > 0.1
    assert errors[1].max() < 0.015


def test_default_frequencies_are_the_excited_ones():
    b, a = resonance()
    u = flown_sweep()
    flown = record(
        u=u, theta=lfilter(b, a, u) + 0.02 * np.random.default_rng(0).standard_normal(u.size)
    )
    got = spectral_response(flown, points=25)
    windowed = spectral_response(flown, points=25, windows=[22.0, 5.0])
    assert 20 <= len(got) <= 60
    assert 20 <= len(windowed) <= 25
    assert got.omega[0] < HZ * 0.15
    assert HZ * 4 < got.omega[-1] < HZ * 7.5  # a point or two may drown in the noise


def test_smearing_of_short_windows_is_in_the_variance():
    """A 4 % damped mode, hardly any noise: windows of 5 s are given great weight at 10 rad/s, none at the mode."""
    b, a = resonance(6.0, 0.04)
    rng = np.random.default_rng(0)
    u = rng.standard_normal(300 * RATE)
    flown = record(u=u, theta=lfilter(b, a, u) + 0.3 * rng.standard_normal(u.size))
    omega = np.linspace(5.0, 7.0, 21)
    got = spectral_response(flown, omega=omega, windows=[60.0, 20.0])
    error = np.abs(got.response - freqz(b, a, omega / RATE)[1])
    assert np.mean(error**2 / got.variance) < 1.5


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
    """12 sweeps with heavy noise: the direct ratio tends to the controller's inverse, the joint one to the plant."""
    r = np.tile(flown_sweep(FAST, amplitude=0.06), (12, 1))
    u, theta = fly(r, 0.01)
    flown = [record(FAST, u=a, theta=b, r=c) for a, b, c in zip(u, theta, r, strict=True)]
    omega = np.geomspace(1.5, 25, 8)
    truth = vehicle_response(omega)
    direct = spectral_response(flown, omega=omega)
    joint = spectral_response(flown, omega=omega, instrument="r")
    assert np.mean(np.abs(direct.response / truth - 1)) > 0.3
    assert np.mean(covered(direct, truth)) < 0.3
    truth = vehicle_response(joint.omega)
    assert np.mean(np.abs(joint.response / truth - 1)) < 0.12
    assert np.mean(covered(joint, truth)) >= 0.85
    assert np.all(direct.coherence[-2:] > 0.6)  # and a fair coherence is no excuse


@pytest.mark.parametrize("windows", [None, [20.0, 10.0]])
def test_where_the_instrument_hardly_moves_the_input_there_is_no_joint_estimate(windows):
    """4 sweeps in a gale: at low frequencies the loop holds the input, and what moves it there is noise."""
    r = np.tile(flown_sweep(FAST, amplitude=0.06), (4, 1))
    standardized = []
    for u, theta, injected in zip(*fly(r, 0.04), r, strict=True):
        flown = record(FAST, u=u, theta=theta, r=injected)
        joint = spectral_response(flown, instrument="r", band=(0.7, 30), windows=windows)
        truth = vehicle_response(joint.omega)
        assert "where the instrument hardly moves u, at 0." in joint.about["dropped"]
        standardized.append(np.abs(joint.response - truth) ** 2 / joint.variance)
    assert 0.7 < np.sqrt(np.mean(np.concatenate(standardized))) < 1.4
    noise = np.random.default_rng(3).standard_normal(theta.size)
    with pytest.raises(
        ValueError, match="the instrument hardly moves u: at no frequency is its part 10 times"
    ):
        spectral_response(
            record(FAST, u=u, theta=theta, r=noise),
            instrument="r",
            omega=[3.0, 6.0],
            windows=windows,
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
    one, many = (spectral_response(r, omega=[4.0, 8.0], windows=[8.0]) for r in (flown[0], flown))
    assert np.all(many.dof > 6 * one.dof)
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
        (lambda r: spectral_response(r, omega=[0.01], windows=[10.0]), "fewer than 2 periods"),
        (lambda r: spectral_response(r, windows=[1e4]), "the longest stretch"),
        (lambda r: spectral_response(r, overlap=1.0), "overlap is 1"),
        (lambda r: spectral_response(r, detrend="cubic"), "detrend 'cubic'"),
        (lambda r: spectral_response(r, "v"), "no signal 'v'"),
        (lambda r: spectral_response(r, "still"), "still does not change"),
        (lambda r: spectral_response(r, "missing"), "missing, theta are all present"),
        (lambda r: spectral_response(r.between(0, 0.1)), "record longer"),
        (lambda r: spectral_response(Record(r.time**1.01, r.signals)), "rate="),
    ],
)
def test_mistakes_are_sentences(call, words):
    rng = np.random.default_rng(0)
    u = rng.standard_normal(30 * RATE)
    flown = record(u=u, theta=u, still=np.ones(u.size), missing=np.full(u.size, np.nan))
    with pytest.raises((ValueError, KeyError), match=words):
        call(flown)


def test_a_band_is_kept_to_as_far_as_the_record_resolves_it():
    b, a = resonance()
    u = flown_sweep()
    flown = record(u=u, theta=lfilter(b, a, u))
    got = spectral_response(flown, band=(3.0, 1000.0))
    assert got.omega.min() >= 3.0
    assert got.omega.max() <= 0.4 * HZ * RATE
    with pytest.raises(ValueError, match="lies outside of what these records resolve"):
        spectral_response(flown, band=(1e-4, 1e-3))
    with pytest.raises(ValueError, match="give 0 < low < high"):
        spectral_response(flown, band=(3.0, 2.0))


def test_dropped_points_are_told():
    """Noise in the output drowns the upper frequencies of the sweep."""
    b, a = resonance()
    u = flown_sweep()
    y = lfilter(b, a, u) + 0.5 * np.random.default_rng(0).standard_normal(u.size)
    got = spectral_response(record(u=u, theta=y))
    assert " points, of a coherence below 0.6, at " in got.about["dropped"]
    assert spectral_response(record(u=u, theta=lfilter(b, a, u))).about == {}


@pytest.mark.parametrize(
    ("band", "inside"),
    [((0.1, 5), (1, 5)), ((2, 50), (2, 20)), ((2, 5), (2, 5)), ((0.1, 50), (1, 20))],
)
def test_of_a_band_is_left_what_the_records_resolve(band, inside):
    assert composite_windows._within(band, 1, 20) == inside
    for outside in ((0.1, 1), (20, 30)):
        with pytest.raises(
            ValueError, match="lies outside of what these records resolve, 1 to 20 rad/s"
        ):
            composite_windows._within(outside, 1, 20)


def test_estimates_of_several_windows_are_weighted_by_their_errors():
    """By the formula; what they differ beyond the noise of the longest is added."""
    point = composite_windows.WindowedPoint
    known = [point(1.0 + 0j, 0.01, 10.0, 0.9), point(1.4 + 0j, 0.0025, 20.0, 0.8)]
    found = composite_windows._combined([*known, point(weak=True)])
    error = np.array([0.1 / 1.0, 0.05 / 1.4])
    weight = (error / error.min()) ** -composite_windows.SHARPNESS
    weight /= weight.sum()
    assert found.response == pytest.approx(weight @ [1.0, 1.4])
    smeared = (weight[1] * 0.4) ** 2 - 0.01
    assert smeared > 0
    assert found.variance == pytest.approx((weight @ [0.1, 0.05]) ** 2 + smeared)
    assert (found.dof, found.coherence) == (
        pytest.approx(weight @ [10, 20]),
        pytest.approx(weight @ [0.9, 0.8]),
    )
    assert composite_windows._combined([point(weak=True), point()]).weak
    assert not composite_windows._combined([point(), point()]).weak


# --- which frequencies, and which windows


def excited_between(*bands, rest):
    """Lines from 1 to 1000 rad/s whose power falls with the frequency, and between bands is a `rest` of that."""
    omega = np.arange(1.0, 1001.0)
    inside = np.any([(omega >= low) & (omega <= high) for low, high in bands], axis=0)
    values = np.sqrt(np.where(inside, 1.0, rest) / omega)
    return composite_windows.Lines(
        omega, np.array([values, values, -1j * values]), np.zeros(1000, int), 1.0, True
    )


@pytest.mark.parametrize(
    ("bands", "rest", "ends"),
    [
        (((50, 300),), 0.0065, (50 / 1.15, 300 / 0.85)),
        (((50, 300),), 0.015, (10, 800)),  # 20 dB below the excitation ends
        (
            ((50, 100), (115, 300)),
            0.005,
            (50 / 1.15, 300 / 0.85),
        ),  # a gap no wider than what is averaged
        (((50, 100), (190, 300)), 0.005, (190 / 1.15, 300 / 0.85)),
        (((30, 100), (250, 300)), 0.005, (30 / 1.15, 100 / 0.85)),
    ],
)
def test_a_sweep_is_excited_up_to_the_first_gap_around_its_strongest_part(bands, rest, ends):
    lines = excited_between(*bands, rest=rest)
    if len(bands) == 2:
        strong = (
            slice(bands[0][0] - 1, bands[0][1])
            if ends[0] < 100
            else slice(bands[1][0] - 1, bands[1][1])
        )
        lines.values[2, strong] *= 1.5
    found = composite_windows._excited_band(lines, 10.0, 800.0)
    assert found == pytest.approx(ends, rel=(800 / 10) ** (1 / 199) - 1 + 0.01)


def test_noise_is_averaged_over_two_lines_on_either_side_at_least():
    """Where lines are few, a hole of three of them is none, and one of six is."""
    for hole, low in ((3, 3.0), (6, 12.2)):
        lines = excited_between((1, 1000), rest=1.0)
        lines.values[2, 7 : 7 + hole] = 0.0
        lines.values[2, 100:200] *= 2
        assert composite_windows._excited_band(lines, 3.0, 400.0)[0] == pytest.approx(low, abs=0.4)
    with pytest.raises(
        ValueError,
        match=r"their lowest frequency, 5 rad/s, is above the highest .* allows, 5 rad/s",
    ):
        composite_windows._excited_band(lines, 5.0, 5.0)


def test_windows_have_eight_samples_at_least_and_fit_into_the_longest_stretch():
    stretches = [UniformStretch(np.zeros((3, n)), step, "") for n, step in ((50, 0.1), (60, 0.05))]
    assert composite_windows._window_lengths(stretches, [0.8, 5.0, 2.0]) == [5.0, 2.0, 0.8]
    for windows, said in (([0.79, 2.0], "0.79, 2"), ([2.0, 5.01], "2, 5.01"), ([], "no")):
        sentence = f"windows of {said} s do not fit: give lengths from 0.8 to 5 s, from 8 samples to the longest stretch"
        with pytest.raises(ValueError, match=sentence):
            composite_windows._window_lengths(stretches, windows)


def test_frequencies_have_as_many_periods_as_an_estimate_needs():
    composite_windows._check_periods(np.array([2.0, 1.0 - 1e-10]), 1.0, 6 * HZ)
    for wrong in (1.0 - 1e-8, np.nan):
        with pytest.raises(
            ValueError,
            match=r"rad/s has fewer than 6 periods in the longest .* window, 37\.7 s: leave",
        ):
            composite_windows._check_periods(np.array([2.0, wrong]), 1.0, 6 * HZ)


def test_the_grid_reaches_from_two_periods_of_the_longest_window_to_four_tenths_of_the_sampling_rate():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(20 * RATE)
    flown = record(u=u, theta=u + 0.01 * rng.standard_normal(u.size))
    got = spectral_response(flown, windows=[4.0, 10.0], band=(1e-3, 1e4), points=7)
    np.testing.assert_allclose(got.omega, np.geomspace(2 * HZ / 10, 0.4 * HZ * RATE, 7))
    got = spectral_response(flown, band=(1e-3, 1e4), points=12)
    assert 6 * HZ / 20 < got.omega[0] < 9 * HZ / 20
    assert 0.34 * HZ * RATE < got.omega[-1] < 0.4 * HZ * RATE
    np.testing.assert_allclose(
        spectral_response(flown, windows=[4.0], band=(5.0, 50.0), points=1).omega, [5, 50]
    )
    with pytest.raises(ValueError, match=r"overlap is -0\.1: it must be at least 0 and below 1"):
        spectral_response(flown, overlap=-0.1)
    assert len(spectral_response(flown, omega=5.0, windows=[4.0], overlap=0.0)) == 1
