"""Finite-frequency estimates against systems that are known, in open and in closed loop, with and without noise."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose
from sampled_sines import amplitude, irregular, sine
from scipy import signal, stats

from greybox.data.excited_segment import Segment
from greybox.data.record import Record
from greybox.data.saturation import at_limit
from greybox.data.spectral import single_sine
from greybox.data.spectral.single_sine import finite_frequency, frequency_error, saturation

STEP = 1 / 400  # s
K, A, TAU = 91.0, -0.68, 0.05  # an unstable plant K / ((TAU s + 1) s (s + A)), one step of delay

uneven = functools.partial(st.floats, allow_nan=False, allow_infinity=False)


def one_test(u, y, t, omega, **words):
    record = Record(t, {"u": u, "theta": y, **words.pop("signals", {})})
    return finite_frequency(record, [Segment(t[0], t[-1], omega=omega)], **words)


# --- exactness


@given(
    seed=st.integers(0, 10_000),
    omega=uneven(1, 30),
    gain=uneven(0.01, 100),
    phase=uneven(-3.1, 3.1),
    periods=st.integers(1, 12),
)
@settings(max_examples=20, deadline=None)
def test_a_noise_free_periodic_response_is_exact(seed, omega, gain, phase, periods):
    t = irregular(
        seed, 5 + periods * 2 * math.pi / omega
    )  # its steps are random, so its length is too
    truth = gain * np.exp(1j * phase)
    u = sine(t, omega, 0.3 - 0.2j) + 0.1 * np.sin(2 * omega * t) + 0.02 * t - 1
    y = sine(t, omega, truth * (0.3 - 0.2j)) + 0.5 - 0.01 * t
    found = one_test(u, y, t, omega)
    assert abs(found.response.response[0] / truth - 1) < 1e-9


def test_a_point_holds_amplitudes_distortion_and_drift_of_its_whole_periods():
    """Of 10.5 s of a sine of 1 s, settled for 2 s: 8 periods, of control, output and setpoint, and of trends."""
    t = 3 + 0.01 * np.arange(1050)
    omega = 2 * math.pi
    truth = 1.5 * np.exp(-0.4j)
    since = t - t[0]
    u = 0.5 * np.sin(omega * since) + 0.1 * np.cos(2 * omega * since) + 0.02 * since
    y = (
        np.imag(truth * 0.5 * np.exp(1j * omega * since))
        + 0.03 * np.sin(3 * omega * since)
        + 0.05 * since
        - 1
    )
    r = 0.4 * np.cos(omega * since)
    found = one_test(u, y, t, omega, signals={"r": r}, setpoint="r", settle=2.0)
    (point,) = found.points
    assert (point.omega, point.periods) == (omega, 8)
    assert 5.0 <= point.start < 5.51
    assert point.end - point.start == pytest.approx(8.0, abs=0.011)
    for value, expected in ((point.u, 0.5), (point.y, 0.5 * truth)):
        assert value == pytest.approx(expected, abs=1e-3)
    assert point.response == pytest.approx(truth, rel=1e-3)
    assert point.distortion == pytest.approx((0.1 / 0.5, 0.03 / 0.75), rel=0.02)
    assert point.drift == pytest.approx((0.02 * 8, 0.05 * 8), rel=0.02)
    assert point.saturation < 0.02
    assert found.findings == (
        "6.28319 rad/s: the control has harmonics of 20% of its sine: the response is not linear there",
        "6.28319 rad/s: the trim of the control drifts by 0.16, and its amplitude is 0.5",
        "6.28319 rad/s: the trim of the output drifts by 0.4, and its amplitude is 0.75",
    )


@pytest.mark.parametrize(("every", "share"), [(10, "10%"), (15, "7%"), (25, "")])
def test_missing_samples_are_told_from_five_percent(every, share):
    t = 0.01 * np.arange(1000)
    omega = 2 * math.pi
    kept = np.arange(1000) % every != 5
    u, y = np.sin(omega * t), 2 * np.cos(omega * t)
    found = one_test(u[kept], y[kept], t[kept], omega, settle=1.0)
    assert found.response.response[0] == pytest.approx(2j, rel=1e-6)
    expected = (f"6.28319 rad/s: {share} of the samples are missing",) if share else ()
    assert found.findings == expected


def test_a_lag_has_a_negative_phase_and_a_delay_too():
    t = np.arange(8000) * STEP
    omega = 2 * math.pi / (160 * STEP)
    truth = np.exp(-1j * omega * 0.004) / (0.05j * omega + 1)
    found = one_test(np.sin(omega * t), sine(t, omega, truth), t, omega)
    assert_allclose(found.response.response, truth, rtol=1e-9)
    assert found.response.beta[0] < 0
    assert found.response.omega[0] == omega
    assert max(found.points[0].distortion) < 1e-9


# --- closed loop with noise: an unstable plant, cascaded control of the measured output


def plant():
    a = np.array([[0, 1, 0], [0, -A, K], [0, 0, -1 / TAU]])
    discrete = signal.cont2discrete(
        (a, np.array([[0], [0], [1 / TAU]]), np.eye(3), np.zeros((3, 1))), STEP
    )
    return discrete[0], discrete[1]


def truth(omega):
    a, b = plant()
    z = np.exp(1j * omega * STEP)
    return np.linalg.solve(z * np.eye(3) - a, b)[0, 0] / z


def colored(rng, shape, sd, pole):
    white = rng.standard_normal(shape)
    start = white[:, :1] * pole  # stationary from the first sample
    return sd * signal.lfilter([math.sqrt(1 - pole**2)], [1, -pole], white, axis=1, zi=start)[0]


@functools.cache
def flights(omega, periods, repeats, sd, pole):
    """Setpoint (n,), control and output (repeats, n) of the closed loop with output noise."""
    a, b = plant()
    n = round((3 + periods * 2 * math.pi / omega) / STEP) + 1
    t = np.arange(n) * STEP
    r = 0.05 * np.sin(omega * t)
    noise = colored(np.random.default_rng(7), (repeats, n), sd, pole).T
    x, held, filtered = np.zeros((3, repeats)), np.zeros(repeats), noise[0].copy()
    u, y = np.zeros((n, repeats)), np.zeros((n, repeats))
    for k in range(n):
        y[k] = x[0] + noise[k]
        rate = (y[k] - filtered) / 0.01
        filtered = filtered + rate * STEP
        u[k] = 0.12 * (4.5 * (r[k] - y[k]) - rate)
        x = a @ x + b * held
        held = u[k]
    return t, r, u.T, y.T


def estimates(omega, periods, repeats, sd, pole, **words):
    t, r, us, ys = flights(omega, periods, repeats, sd, pole)
    found = [
        one_test(u, y, t, omega, setpoint="r", signals={"r": r}, settle=3.0, **words).response
        for u, y in zip(us, ys, strict=True)
    ]
    return tuple(
        np.array([getattr(f, name)[0] for f in found]) for name in ("response", "variance", "dof")
    )


def coverage(error, variance, dof):
    half = stats.t.ppf(0.975, dof) * np.sqrt(
        variance / 2
    )  # a variance is E|P̂ - P|², both components together
    return (np.mean(np.abs(error.real) < half) + np.mean(np.abs(error.imag) < half)) / 2


@pytest.mark.parametrize(
    ("omega", "periods", "sd", "pole"),
    [
        (8.0, 10, 0.004, 0.99),
        (16.0, 20, 0.02, 0.0),
    ],
)
def test_intervals_cover_in_closed_loop(omega, periods, sd, pole):
    response, variance, dof = estimates(omega, periods, 100, sd, pole)
    error = response - truth(omega)
    assert 0.92 <= coverage(error, variance, dof) <= 0.97
    assert np.all(dof == dof[0])
    assert abs(error.mean()) < 4 * np.sqrt(np.mean(np.abs(error) ** 2) / 100) + 1e-3 * abs(
        truth(omega)
    )
    assert 0.9 < np.sqrt(variance.mean() / np.mean(np.abs(error) ** 2)) < 1.35


@pytest.mark.parametrize("periods", [2, 10])
@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_intervals_cover_in_open_loop(periods, pole):
    rng = np.random.default_rng(3)
    omega = 2 * math.pi / (100 * STEP)
    t = np.arange((periods + 1) * 100) * STEP
    u, g = np.sin(omega * t), 2 * np.exp(-0.8j)
    noise = colored(rng, (100, t.size), 0.3, pole)
    found = [one_test(u, sine(t, omega, g) + v, t, omega, settle=0.1).response for v in noise]
    response, variance, dof = (
        np.array([getattr(f, n)[0] for f in found]) for n in ("response", "variance", "dof")
    )
    assert 0.92 <= coverage(response - g, variance, dof) <= 0.98  # twice its error by chance


def test_the_direct_ratio_of_spectra_is_biased_in_closed_loop():
    omega, periods = 3.0, 10
    t, _, us, ys = flights(omega, periods, 40, 0.02, 0.0)
    response, *_ = estimates(omega, periods, 40, 0.02, 0.0)
    wave = np.exp(-1j * omega * t)[-round(periods * 2 * math.pi / omega / STEP) :]
    u, y = (
        [[part.sum() for part in np.array_split(x[-wave.size :] * wave, periods)] for x in xs]
        for xs in (us, ys)
    )
    u, y = np.array(u), np.array(y)
    direct = np.sum(y * u.conj(), axis=1) / np.sum(np.abs(u) ** 2, axis=1)
    bias = abs(direct.mean() / truth(omega) - 1), abs(response.mean() / truth(omega) - 1)
    assert bias[0] > 0.05
    assert bias[1] < 0.005


def test_leakage_of_a_wandering_plant_is_taken_off():
    """Against a ratio of the sines fitted to output and control."""
    omega, periods = 3.0, 10
    response, *_ = estimates(omega, periods, 40, 0.02, 0.0)
    t, _, us, ys = flights(omega, periods, 40, 0.02, 0.0)
    plain = np.array(
        [
            amplitude(t, y, omega, 2.0) / amplitude(t, u, omega, 2.0)
            for u, y in zip(us, ys, strict=True)
        ]
    )
    ours, ratio = (np.sqrt(np.mean(np.abs(p / truth(omega) - 1) ** 2)) for p in (response, plain))
    assert ours < 0.5 * ratio


# --- what is found, and what is left out

OMEGA = 5.0
T = np.arange(6000) * STEP


def flight(u=None, y=None, noise=1e-4, **words):
    rng = np.random.default_rng(0)
    u = np.sin(OMEGA * T) if u is None else u
    y = sine(T, OMEGA, 0.5 - 0.5j) if y is None else y
    return one_test(u, y + noise * rng.standard_normal(T.size), T, OMEGA, **words)


def said(found):
    return "; ".join((*found.notes, *found.findings))


def test_a_clean_test_has_nothing_to_say():
    found = flight()
    assert found.findings == ()
    point = found.points[0]
    assert point.saturation == 0
    assert max(point.distortion) < 1e-3
    assert "u -> theta, 1 frequency" in str(found)
    assert "harmonics" in str(found)


def test_harmonics_saturation_and_drift_are_flagged():
    clipped = np.clip(1.5 * np.sin(OMEGA * T), -1, 1)
    found = flight(u=clipped)
    assert found.points[0].saturation == pytest.approx(0.53, abs=0.02)
    assert "at its limit for 54%" in said(found)
    assert "control has harmonics of 15%" in said(found)
    assert "trim of the output drifts by" in said(flight(y=sine(T, OMEGA, 0.5 - 0.5j) + 0.1 * T))
    assert math.isnan(flight(u=np.round(np.sin(OMEGA * T), 2)).points[0].saturation)


def test_a_setpoint_gives_its_amplitude_and_its_true_frequency():
    found = flight(setpoint="r", signals={"r": 3 * np.sin(OMEGA * T)})
    assert found.findings == ()
    t, actual = T, 5.05
    u, y, r = np.sin(actual * t), sine(t, actual, 0.5 - 0.5j), 3 * np.sin(actual * t)
    found = one_test(u, y, t, OMEGA, setpoint="r", signals={"r": r})
    assert found.response.omega[0] == pytest.approx(actual, abs=2e-3)
    assert "the setpoint runs at 5.0" in said(found)
    assert_allclose(found.response.response, 0.5 - 0.5j, rtol=1e-3)


def test_one_period_has_no_variance():
    found = flight(settle=np.ptp(T) - 3 * math.pi / OMEGA)
    assert found.response.variance is None
    assert "one period only: its error is not known" in said(found)
    assert str(found)


def test_what_cannot_be_used_is_left_out_with_the_reason():
    t = np.arange(40_000) * STEP
    rng = np.random.default_rng(0)
    u = np.where(t < 50, np.sin(5 * t), 0) + 0.01 * rng.standard_normal(t.size)
    record = Record(t, {"u": u, "theta": u})
    good, quiet = Segment(0, 20, omega=5.0), Segment(60, 80, omega=7.0)
    short, refused = Segment(20, 23, omega=5.0), Segment(20, 40, omega=5.0).refused("ended early")
    sweep = Segment(0, 20, "sweep", band=(1, 9))
    found = finite_frequency(record, [good, quiet, short, refused, sweep])
    assert len(found.response) == 1
    reasons = [reason for _, reason in found.left_out]
    assert reasons[0].startswith("barely excited: the control's amplitude is")
    assert reasons[1] == "3 s are too short for 2 s of settling and a period of 1.26 s"
    assert reasons[2:] == ["ended early", "a sweep is not a single sine"]
    with pytest.raises(
        ValueError, match="no segment gives a point of the response: a sweep is not a single sine"
    ):
        finite_frequency(record, [sweep])
    with pytest.raises(ValueError, match="no segment gives a point of the response: there is none"):
        finite_frequency(record, [])
    with pytest.raises(ValueError, match=r"several axes \(pitch, roll\)"):
        finite_frequency(record, [Segment(0, 9, axis=a, omega=5.0) for a in ("roll", "pitch")])
    with pytest.raises(KeyError, match="no signal 'q'"):
        finite_frequency(record, [good], output="q")


def test_gaps_and_missing_samples():
    rng = np.random.default_rng(0)
    keep = (rng.random(T.size) > 0.2) & ~((T > 6) & (T < 6.5))
    u, y = np.sin(OMEGA * T), sine(T, OMEGA, 0.5 - 0.5j)
    found = one_test(u[keep], np.where(T[keep] > 14.5, np.nan, y[keep]), T[keep], OMEGA)
    assert_allclose(found.response.response, 0.5 - 0.5j, rtol=1e-9)
    hole = ~((T > 6) & (T < 9))
    with pytest.raises(ValueError, match="a whole period is missing after"):
        one_test(u[hole], y[hole], T[hole], OMEGA)


@pytest.mark.parametrize("samples", [0, 1, 5, 9])
def test_few_samples(samples):
    record = Record(T, {"u": np.sin(T), "theta": np.sin(T)})
    with pytest.raises(ValueError, match="no segment gives a point"):
        finite_frequency(record, [Segment(1.0, 1.001 + samples * STEP, omega=OMEGA)])


def test_repeated_tests_of_one_frequency_are_averaged():
    t = np.arange(20_000) * STEP
    parts = [Segment(0, 25, omega=5.0), Segment(25, 49, omega=5.0)]
    variances = []
    for seed in range(10):
        noise = 0.3 * np.random.default_rng(seed).standard_normal(t.size)
        record = Record(t, {"u": np.sin(5 * t), "theta": sine(t, 5, 0.5 - 0.5j) + noise})
        both, one = (
            finite_frequency(record, parts).points[0],
            finite_frequency(record, parts[:1]).points[0],
        )
        variances.append([both.standard_error**2, one.standard_error**2])
        assert abs(both.response - (0.5 - 0.5j)) < 4 * both.standard_error
    # White noise of deviation s leaves 4 s²/N to the amplitude of a sine over N samples.
    expected = [4 * 0.3**2 / (point.periods * 2 * math.pi / 5 / STEP) for point in (both, one)]
    assert np.mean(variances, axis=0) == pytest.approx(expected, rel=0.3)
    assert both.periods == sum(finite_frequency(record, [p]).points[0].periods for p in parts)
    assert both.dof > one.dof
    assert "mean of 2 tests" in said(finite_frequency(record, parts))


@pytest.mark.parametrize("phase", [0.0, math.pi / 2, 2.0, -math.pi / 2])
def test_a_limit_counts_at_the_ends_of_the_record_too(phase):
    """A wave clipped at half of its size is at its limits for two thirds of every period."""
    t = np.arange(400) * STEP
    omega = 2 * math.pi * 3 / (400 * STEP)
    u = np.clip(2 * np.sin(omega * t + phase), -1, 1)
    assert saturation(u) == pytest.approx(2 / 3, abs=0.01)


@pytest.mark.parametrize("level", [0.1, 0.37, 1500.0])
def test_a_control_that_stands_still_without_noise_is_no_test(level):
    """Only rounding errors are left of it, which are no excitation."""
    t = np.arange(4000) * STEP
    with pytest.raises(ValueError, match="barely excited"):
        one_test(np.full(t.size, level), np.sin(6.1 * t), t, 6.1)


def test_the_error_of_a_frequency_is_the_drift_of_the_phase():
    t = 5 + np.arange(4000) / 100
    for omega in (1.98, 2.0, 2.03):
        r = np.sin(omega * t + 0.3) + 0.7
        assert frequency_error(t, r, 2.0) == pytest.approx(omega - 2.0, abs=5e-4)
    assert frequency_error(t, np.zeros(t.size), 2.0) == 0


# --- the numbers of one window


@pytest.mark.parametrize(("q", "count"), [(2, 1), (6, 2), (12, 3)])
def test_the_lines_beside_a_sine_tell_leakage_and_noise(q, count):
    """A polynomial through what P leaves of them, a constant of two lines, is what it leaves of the sine itself."""
    omega, origin = 2 * math.pi, 0.3
    t = 0.5 + np.arange(40 * q) / 40
    random = np.random.default_rng(q)
    u = np.sin(omega * t) + 0.02 * random.normal(size=t.size)
    y = 2 * np.cos(omega * t) + np.exp(-2 * (t - t[0])) + 0.05 * random.normal(size=t.size)
    x = np.array([u, y])
    amplitudes, _, residual = single_sine.least_squares(t, x, omega, origin, 3)
    found = single_sine.estimate_by_lines(t, amplitudes[:, 0], residual, omega, origin, q)
    m = np.array([k for k in range(-count, count + 1) if k])
    lines = np.array([single_sine.spectral_line(t, residual, omega * (1 + k / q)) for k in m]).T
    at = amplitudes[:, 0] * np.exp(1j * omega * (t[0] - origin))
    left = lines[1] - found.response * lines[0]
    degree = 0 if count == 1 else 1
    polynomial = np.polyfit(m, left, degree)
    assert at[1] - found.response * at[0] == pytest.approx(np.polyval(polynomial, 0), abs=1e-9)
    free = 2 * count - degree - 1
    noise = np.sum(np.abs(left - np.polyval(polynomial, m)) ** 2) / free
    # The value at the sine is a mean of the lines, as they lie evenly beside it.
    assert found.variance == pytest.approx(noise * (1 + 1 / (2 * count)) / abs(at[0]) ** 2)
    assert found.dof == 2 * free
    assert found.control_noise == pytest.approx(np.sqrt(np.mean(np.abs(lines[0]) ** 2)))


def test_only_sines_that_are_usable_need_one_axis():
    t = 0.01 * np.arange(2000)
    record = Record(t, {"u": np.sin(3 * t), "theta": np.cos(3 * t)})
    one = Segment(0.0, 19.99, omega=3.0, axis="roll")
    others = [
        Segment(0.0, 19.99, omega=3.0, axis="yaw").refused("too weak"),
        Segment(0.0, 19.99, kind="sweep", axis="pitch", band=(1.0, 5.0)),
    ]
    assert len(finite_frequency(record, [one, *others]).points) == 1
    with pytest.raises(
        ValueError, match=r"the segments are of several axes \(pitch, roll\): choose one"
    ):
        finite_frequency(record, [one, Segment(0.0, 19.99, omega=3.0, axis="pitch")])


@pytest.mark.parametrize(
    ("held", "flat", "saturated"), [(1, 2, False), (1, 3, True), (2, 5, False), (2, 6, True)]
)
def test_a_flat_top_is_three_times_as_long_as_other_values_and_three_samples_at_least(
    held, flat, saturated
):
    rising = np.repeat(np.linspace(-1, 1, 3001)[1:-1], held)
    u = np.concatenate([[-1.0], rising, np.full(flat, 1.0), rising[::-1]])
    assert saturation(u) == pytest.approx(flat / u.size if saturated else 0.0)
    assert saturation(-u) == pytest.approx(flat / u.size if saturated else 0.0)


@pytest.mark.parametrize(("levels", "rests_at_limits"), [(11, False), (12, True)])
def test_a_control_of_fewer_than_twelve_levels_rests_at_them_by_design(levels, rests_at_limits):
    u = np.repeat(np.arange(levels), np.where(np.arange(levels) % (levels - 1), 1, 5))
    assert at_limit(u).any() == rests_at_limits


@pytest.mark.parametrize("ramp", [0.02, 0.1, 0.3])
def test_a_ramped_3211_rests_by_design(ramp):
    time = 0.01 * np.arange(2000)
    edges = 2.003 + np.array([0, 3, 5, 6, 7])
    heights = np.array([1, -2, 2, -2, 1])
    u = heights @ np.clip((time - edges[:, None]) / ramp, 0, 1)
    assert not at_limit(u).any()
    # Where an amplifier cuts a signal, that is a limit.
    random = np.random.default_rng(0)
    noise = np.cumsum(random.normal(size=2000))
    for gain in (1.1, 1.5, 3, 5):
        assert at_limit(np.clip(gain * np.sin(3 * time), -1, 1)).any()
        assert at_limit(np.clip(gain * noise / np.abs(noise).max(), -1, 1)).any()


def test_a_control_of_few_values_does_not_show_its_limits():
    """Steps of more than a two-thousandth of its travel."""
    for step, known in ((4.9e-4, True), (5.1e-4, False)):
        u = np.round(np.sin(np.linspace(0, 9, 40_000)) / (2 * step)) * 2 * step
        assert math.isnan(saturation(u)) != known


def test_one_period_has_a_response_and_white_noise_of_its_control():
    """Amplitudes over one another, and 4 σ²/N of the residual's variance; nothing of a control that does not move."""
    t = 2 + np.arange(50) * 0.02
    residual = np.array([0.3, -0.1] * 25), np.zeros(50)
    found = single_sine.estimate_by_lines(
        t, np.array([2 - 1j, 3j]), np.array(residual), 2 * math.pi, 1.3, 1
    )
    assert found.response == pytest.approx(3j / (2 - 1j))
    assert found.control_noise == pytest.approx(math.sqrt(4 * 0.05 / 50))
    assert math.isnan(found.variance)
    assert found.dof == 0
    still = single_sine.estimate_by_lines(
        t, np.array([0j, 3j]), np.array(residual), 2 * math.pi, 1.3, 4
    )
    assert (still.response, still.dof, still.control_noise) == (0, 0, found.control_noise)


@pytest.mark.parametrize(("size", "used"), [(1.15, False), (1.3, True)])
def test_a_control_is_excited_where_it_is_three_times_its_noise(size, used):
    """Noise at one of six lines, of size one: their mean square is a sixth."""
    omega, q = 2 * math.pi, 12
    t = np.arange(100 * q) / 100
    u = size * np.sin(omega * t) + np.cos(omega * (1 + 2 / q) * t)
    if used:
        (point,) = one_test(u, 2 * u, t, omega, settle=0.0).points
        assert abs(point.u) == pytest.approx(size, rel=0.02)
    else:
        with pytest.raises(
            ValueError, match=r"barely excited: the control's amplitude is 1\.\d, its noise 0\.41"
        ):
            one_test(u, 2 * u, t, omega, settle=0.0)


@pytest.mark.parametrize(("drift", "used"), [(0.048, False), (0.052, True)])
def test_the_frequency_of_the_setpoint_is_used_where_its_phase_drifts_by_a_twentieth(drift, used):
    """Over ten periods of one second."""
    omega = 2 * math.pi
    actual = omega + drift / 10
    t = np.arange(1000) / 100
    found = one_test(
        np.sin(actual * t),
        np.cos(actual * t),
        t,
        omega,
        settle=0.0,
        setpoint="r",
        signals={"r": np.sin(actual * t)},
    )
    assert found.points[0].omega == (pytest.approx(actual, abs=1e-5) if used else omega)
    assert found.notes == (
        (f"{actual:g} rad/s: the setpoint runs at {actual:.5g} rad/s, which was used",)
        if used
        else ()
    )


def test_a_response_names_its_record_units_and_stretches():
    t = np.arange(0.0, 50.0, 0.01)
    u = np.sin(2 * math.pi * t)
    record = Record(
        t, {"u": u, "theta": (3 - 4j).real * u}, {"u": "N", "theta": ""}, name="r", source="r.csv"
    )
    found = finite_frequency(record, [Segment(0.0, 49.99, omega=2 * math.pi)])
    (point,) = found.points
    assert 2.0 <= point.start < 2.02  # settled for two seconds
    assert point.periods == 48
    assert (found.response.name, found.response.source, dict(found.response.units)) == (
        "r",
        "r.csv",
        {"u": "N"},
    )
    (stretch,) = found.response.stretches
    assert (stretch.checksum, stretch.start, stretch.end) == (
        record.checksum,
        point.start,
        point.end,
    )


def test_three_harmonics_are_fitted():
    omega = 2 * math.pi
    t = np.arange(2000) / 100
    sizes = (1, 0.3, 0.04, 0.2)
    u = sum(size * np.sin(k * omega * t + k) for k, size in enumerate(sizes, 1))
    share = math.hypot(0.3, 0.04)
    assert one_test(u, u, t, omega).points[0].distortion == pytest.approx((share, share), rel=1e-3)
