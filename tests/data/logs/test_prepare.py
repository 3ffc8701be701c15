"""`prepare`: signals of different messages on one time base, against signals known in closed form."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import constants as c

import greybox as gb
from greybox.data.logs.known_filters import LowPass as KnownLowPass
from greybox.data.logs.prepare import Derived
from greybox.data.record import Record, Recording

RANDOM = np.random.default_rng(0)


def recording(metadata=None, **messages):
    """Build a recording from message -> (time, {field: values}, {field: unit})."""
    return Recording(
        {name: Record(t, s, u) for name, (t, s, u) in messages.items()},
        "made.bin",
        "sum",
        metadata or {},
    )


def stamps(rate, duration, jitter=0.0, start=0.0):
    time = start + np.arange(int(duration * rate)) / rate
    return time + jitter / rate * RANDOM.uniform(-0.5, 0.5, time.size)


def wave(time, omega=3.0):
    return np.sin(omega * time + 0.3)


def test_signals_of_different_rates_meet_by_their_time_stamps():
    fast, slow = stamps(400, 20, 0.4), stamps(23.6, 20, 0.4, start=0.11)
    log = recording(
        RATE=(fast, {"POut": wave(fast)}, {}), XKF1=(slow, {"VN": wave(slow)}, {"VN": "m/s"})
    )
    record = gb.prepare(log, {"u": "RATE.POut", "v": "XKF1.VN"}, rate=50)
    assert np.ptp(np.diff(record.time)) < 1e-9
    assert record.rate == pytest.approx(50)
    inner = slice(10, -10)
    assert record["u"][inner] == pytest.approx(wave(record.time[inner]), abs=1e-3)
    assert record["v"][inner] == pytest.approx(wave(record.time[inner]), abs=1e-3)
    assert record.units["v"] == "m/s"
    assert record.checksum == "sum"


def test_what_is_no_recording_is_named():
    with pytest.raises(TypeError, match=r"recording is 'flight\.BIN': give what gb\.read"):
        gb.prepare("flight.BIN", {"u": "RATE.POut"})


def test_the_default_rate_is_that_of_the_slowest():
    fast, slow = stamps(400, 5), stamps(25, 5)
    log = recording(A=(fast, {"x": fast}, {}), B=(slow, {"y": slow}, {}))
    assert gb.prepare(log, {"x": "A.x", "y": "B.y"}).rate == pytest.approx(25)


def test_coarse_stamps_count_as_the_clock_that_they_round():
    """A sine at 833 Hz in stamps of 1 ms, which are up to 0.5 ms off."""
    exact = np.arange(3000) / 833
    log = Record(np.round(exact, 3), {"y": np.sin(20 * exact)})
    prepared = gb.prepare(log, {"y": "y"})
    assert prepared.rate == pytest.approx(833, rel=1e-5)
    assert np.abs(prepared["y"] - np.sin(20 * prepared.time)).max() < 0.1 * 20 * 0.5e-3


@pytest.mark.parametrize(
    ("omega", "kept"), [(2 * np.pi * 5, 1.0), (2 * np.pi * 17, 1.0), (2 * np.pi * 60, 0.0)]
)
def test_what_is_above_half_the_new_rate_is_filtered_and_the_rest_is_not(omega, kept):
    time = stamps(400, 20)
    record = gb.prepare(recording(A=(time, {"x": wave(time, omega)}, {})), {"x": "A.x"}, rate=50)
    inner = slice(60, -60)
    expected = kept * wave(record.time[inner], omega)
    assert record["x"][inner] == pytest.approx(expected, abs=2e-3)


def test_units_become_si_and_angles_are_unwrapped():
    time = stamps(100, 10)
    heading = np.degrees(1.5 * time) % 360
    log = recording(
        ATT=(
            time,
            {"Yaw": heading, "Pitch": np.full(time.size, 3.001)},
            {"Yaw": "deg", "Pitch": "deg"},
        ),
        RATE=(time, {"P": np.full(time.size, 180.0)}, {"P": "deg/s"}),
    )
    record = gb.prepare(
        log,
        {"psi": "ATT.Yaw", "theta": "ATT.Pitch", "q": "RATE.P"},
        rate=100,
    )
    assert record.units == {"psi": "rad", "theta": "rad", "q": "rad/s"}
    assert record["psi"] == pytest.approx(1.5 * record.time, abs=1e-9)
    assert record["theta"] == pytest.approx(np.radians(3.001))
    assert record["q"] == pytest.approx(np.pi)


def test_units_of_flight_tests_become_si():
    time = stamps(50, 4)
    units = {
        "h": "ft",
        "V": "kt",
        "az": "g",
        "qbar": "psf",
        "T": "°C",
        "rotor": "RPM",
        "throttle": "%",
        "m": "slug",
    }
    expected = {
        "h": (c.foot, "m"),
        "V": (c.knot, "m/s"),
        "az": (c.g, "m/s²"),
        "qbar": (c.pound_force / c.foot**2, "Pa"),
        "rotor": (c.pi / 30, "rad/s"),
        "throttle": (0.01, "1"),
        "m": (c.slug, "kg"),
    }
    log = recording(A=(time, {name: 2 + wave(time) for name in units}, units))
    record = gb.prepare(log, {name: f"A.{name}" for name in units})
    for name, (factor, unit) in expected.items():
        assert record.units[name] == unit
        assert record[name] == pytest.approx(factor * (2 + wave(record.time)), rel=1e-6)
    assert record.units["T"] == "K"
    assert record["T"] == pytest.approx(c.zero_Celsius + 2 + wave(record.time), rel=1e-6)
    assert record.findings == ("A.az: g was taken for 9.80665 m/s², not for gram.",)


def test_a_unit_that_is_not_converted_is_named():
    time = stamps(50, 4)
    log = recording(A=(time, {"F": wave(time), "out": wave(time)}, {"F": "lb", "out": "pwm"}))
    record = gb.prepare(log, {"force": "A.F", "u": "A.out"})
    assert record.units == {"force": "lb", "u": "pwm"}
    assert record["force"] == pytest.approx(wave(record.time), abs=1e-9)
    assert record.findings == (
        "A.F is in 'lb', as in the log, not in SI: lb may be a pound of mass or of force: write lbm or lbf.",
        "A.out is in 'pwm', as in the log, not in SI: the unit 'pwm' is not known.",
    )


def test_nothing_is_invented_across_a_gap():
    time = stamps(100, 20)
    holed = time[(time < 5) | (time > 8)]
    log = recording(A=(time, {"x": wave(time)}, {}), B=(holed, {"y": wave(holed)}, {}))
    record = gb.prepare(log, {"x": "A.x", "y": "B.y"}, rate=100)
    assert len(record.pieces) == 2
    assert record.pieces[0].time[-1] == pytest.approx(5, abs=0.02)
    assert record.pieces[1].time[0] == pytest.approx(8, abs=0.03)
    assert record["y"] == pytest.approx(wave(record.time), abs=1e-4)


def test_a_slower_sensor_in_a_table_is_named_and_stays_missing_where_columns_are_stated(tmp_path):
    path = tmp_path / "flight.csv"
    rows = [f"{0.02 * k:.2f};{k};{k if k % 10 == 0 else ''}" for k in range(200)]
    path.write_text("\n".join(["time [s];rate [deg/s];bank [deg]", *rows]))
    made = gb.prepare(gb.read(path), {"p": "rate", "phi": "bank"})
    (text,) = [text for text in made.findings if "bank" in text]
    assert "interpolated" in text
    as_measured = gb.read(path, columns={"p": "rate", "phi": "bank"})["flight"]
    assert as_measured.units == {"p": "rad/s", "phi": "rad"}
    assert np.isfinite(as_measured["p"]).sum() == 10 * np.isfinite(as_measured["phi"]).sum() == 200


def test_missing_samples_are_left_out():
    time = stamps(100, 5)
    values = wave(time)
    values[100:103] = np.nan
    record = gb.prepare(recording(A=(time, {"x": values}, {})), {"x": "A.x"}, rate=100)
    assert len(record.pieces) == 2


@given(st.floats(-3, 3), st.floats(-2, 2), st.floats(-2, 2))
@settings(max_examples=15, deadline=None)
def test_the_horizontal_velocity_is_turned_into_the_body(yaw, forward, right):
    time = np.arange(0, 1, 0.02)
    ones = np.ones(time.size)
    north, east = (
        forward * np.cos(yaw) - right * np.sin(yaw),
        forward * np.sin(yaw) + right * np.cos(yaw),
    )
    log = recording(
        XKF1=(time, {"VN": north * ones, "VE": east * ones}, {"VN": "m/s", "VE": "m/s"}),
        ATT=(time, {"Yaw": np.degrees(yaw) % 360 * ones}, {"Yaw": "deg"}),
    )
    names = {
        "v": gb.logs.horizontal_velocity(axis="forward"),
        "w": gb.logs.horizontal_velocity(axis="right"),
    }
    names |= {"paper": gb.logs.horizontal_velocity()}
    names |= {"roll": gb.logs.horizontal_velocity(axis="roll")}
    record = gb.prepare(log, names, rate=50)
    assert record["v"] == pytest.approx(forward, abs=1e-9)
    assert record["w"] == pytest.approx(right, abs=1e-9)
    assert record["paper"] == pytest.approx(
        -forward, abs=1e-9
    )  # a positive pitch accelerates backward
    assert record["roll"] == pytest.approx(right, abs=1e-9)  # and a positive roll to the right
    assert set(record.units.values()) == {"m/s"}


def test_another_axis_is_refused():
    with pytest.raises(ValueError, match="axis 'up' is not known"):
        gb.logs.horizontal_velocity(axis="up")


def test_a_stretch_is_cut_out():
    time = stamps(100, 30)
    log = recording(A=(time, {"x": 2 + 0.5 * time}, {}))
    record = gb.prepare(log, {"x": "A.x"}, rate=20, start=5, end=10)
    assert (record.time[0], record.time[-1]) == pytest.approx((5, 10), abs=0.051)


def test_the_gyro_filter_is_recorded():
    time = stamps(100, 2)
    log = recording(
        {"parameters": {"INS_GYRO_FILTER": 20.0}},
        RATE=(time, {"P": time, "POut": time}, {"P": "deg/s"}),
    )
    record = gb.prepare(log, {"u": "RATE.POut", "q": "RATE.P"}, rate=50)
    assert record.filters == {"q": (KnownLowPass(20.0),)}


def test_the_filter_model_is_the_filter():
    from scipy.signal import butter, freqs

    from greybox.models.filters import LowPass

    omega = np.array([1.0, 50, 125, 400])
    _, expected = freqs(*butter(2, 2 * np.pi * 20, analog=True), omega)
    assert gb.frequency_response(LowPass(20.0), {}, omega).response == pytest.approx(
        expected, rel=1e-12
    )


def test_the_digital_filter_model_is_the_digital_filter():
    from evaluation import response_formula
    from scipy.signal import butter, freqz

    from greybox.models.filters import LowPass

    omega = np.array([1.0, 50, 125, 400])
    _, expected = freqz(*butter(2, 20, fs=400), worN=omega, fs=2 * np.pi * 400)
    model = LowPass(20.0, rate=400)
    assert gb.frequency_response(model, {}, omega).response == pytest.approx(expected, rel=1e-9)
    re, im = response_formula(model, omega).closed()(list(model.values().values()))
    assert np.asarray(re).ravel() + 1j * np.asarray(im).ravel() == pytest.approx(expected, rel=1e-9)
    with pytest.raises(ValueError, match="not below half the sampling rate"):
        LowPass(20.0, rate=30)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"signals": {}}, ValueError, "signals is empty"),
        ({"signals": ["u", "y"]}, TypeError, r"signals is \['u', 'y'\]: give \{"),
        ({"signals": {"u": "RATE.Nothing"}}, KeyError, "no signal 'Nothing'; it has POut"),
        ({"signals": {"u": "RTAE.POut"}}, KeyError, "no message 'RTAE'; it has RATE"),
        ({"rate": 0}, ValueError, "rate 0 must be"),
        ({"rate": np.nan}, ValueError, "rate nan must be"),
        ({"start": 100.0}, ValueError, "do not overlap in time"),
        ({"held": "w"}, ValueError, "held names 'w', which is not among the signals"),
    ],
)
def test_bad_input_is_a_sentence(options, error, words):
    time = stamps(100, 5)
    log = recording(RATE=(time, {"POut": wave(time)}, {}))
    with pytest.raises(error, match=words):
        gb.prepare(log, **{"signals": {"u": "RATE.POut"}, "rate": 50, **options})


def test_what_was_logged_behind_a_filter_is_fitted_with_it_and_said():
    from greybox.models.filters import LowPass
    from greybox.models.rate import YawRateLag

    omega = np.geomspace(1, 100, 20)
    plant = YawRateLag()
    behind = plant * LowPass(20.0, signal="r")
    truth = {"K_2": 12.0, "T_2": 0.3, "T_delay": 0.01}
    data = gb.frequency_response(behind, truth, omega)
    assert data.output == "r"
    fit = gb.fit(gb.Problem(behind, data), starts=10, progress=False)
    assert {name: fit.estimate[name] for name in truth} == pytest.approx(truth, rel=1e-5)


def test_known_filters_survive_a_second_preparation_and_are_noted():
    time = stamps(100, 20)
    log = recording(
        {"parameters": {"INS_GYRO_FILTER": 20.0}},
        RATE=(time, {"P": wave(time), "POut": wave(time, 2.0)}, {"P": "deg/s"}),
    )
    first = gb.prepare(log, {"u": "RATE.POut", "q": "RATE.P"}, rate=50)
    again = gb.prepare(first, {"u": "u", "q2": "q"}, rate=50)
    assert again.filters == {"q2": (KnownLowPass(20.0),)}
    (note,) = [f for f in gb.spectral.check(first, output="q").findings if f.about == "filters"]
    assert "20 Hz low-pass" in note.text


# --- how signals run between samples


def staircase(rate, duration, hold=None, seed=0):
    """A log of a control that is held, and the integral of the held control at any time."""
    time = stamps(rate, duration)
    values = np.random.default_rng(seed).normal(size=time.size)
    log = Record(
        time,
        {"u": values, "y": np.zeros(time.size)},
        name="A",
        hold={} if hold is None else {"u": hold},
    )
    ends = np.append(time[1:], time[-1] + 1 / rate)
    area = np.append(0.0, np.cumsum(values * (ends - time)))
    return log, lambda t: np.interp(t, np.append(time, ends[-1]), area)


@pytest.mark.parametrize("rate", [50, 51, 80, 200])
@pytest.mark.parametrize("start", [0.0, 0.013])
def test_what_is_held_keeps_its_integral_at_its_own_rate_and_above(rate, start):
    """Then a plant is driven by the same, however the new samples lie; nothing moves by half a step."""
    log, area = staircase(50, 10, np.inf)
    record = gb.prepare(log, {"u": "A.u"}, rate=rate, start=start, end=9.9)
    assert record.hold == {"u": np.inf}
    held = np.append(0.0, np.cumsum(record["u"]) / rate)
    moments = np.append(record.time, record.time[-1] + 1 / rate)
    assert held == pytest.approx(area(moments) - area(moments[0]), abs=1e-9)


def test_at_its_own_samples_what_is_held_is_what_was_logged():
    log, _ = staircase(50, 10, np.inf)
    np.testing.assert_allclose(gb.prepare(log, {"u": "A.u"}, rate=50)["u"], log["u"], atol=1e-9)


def test_below_its_rate_what_was_held_lasts_for_a_step_of_the_log():
    time = stamps(400, 20)
    log = Record(time, {"u": wave(time), "y": wave(time)}, name="A", hold={"u": 1 / 400, "y": 0.0})
    record = gb.prepare(log, {"u": "A.u", "y": "A.y"}, rate=50)
    assert record.hold == {"u": pytest.approx(1 / 400), "y": 0.0}
    np.testing.assert_allclose(record["u"], record["y"], atol=1e-9)


@pytest.mark.parametrize("rate", [25, 50, 100])
def test_a_thinned_log_is_interpolated_and_its_hold_is_kept(rate):
    time = stamps(50, 20)
    log = Record(time, {"u": wave(time)}, name="A", hold={"u": 1 / 400})
    record = gb.prepare(log, {"u": "A.u"}, rate=rate)
    assert record.hold == {"u": 1 / 400}
    assert record["u"][60:-60] == pytest.approx(wave(record.time[60:-60]), abs=1e-3)


def test_what_the_log_does_not_say_is_stated_or_unknown():
    log, _ = staircase(50, 10)
    assert gb.prepare(log, {"u": "A.u"}).hold == {}
    assert gb.prepare(log, {"u": "A.u"}, held="u").hold == {"u": np.inf}


def test_a_signal_computed_from_several_runs_as_they_all_do():
    time = stamps(50, 10)
    signals = {name: wave(time) for name in ("a", "b", "c", "d")}
    log = Record(time, signals, name="A", hold={"a": np.inf, "b": np.inf, "c": 0.0})

    def product(*names):
        return Derived(tuple(f"A.{name}" for name in names), lambda *x: np.prod(x, axis=0), "")

    signals = {
        "held": product("a", "b"),
        "mixed": product("a", "c"),
        "unknown": product("c", "d"),
        "c": "A.c",
    }
    assert gb.prepare(log, signals, rate=50).hold == {"held": np.inf, "c": 0.0}


@pytest.mark.parametrize("rate", [100, 50, 20])
@pytest.mark.parametrize("start", [0.0, 0.07, 1e4 + 1 / 3])
def test_the_first_and_the_last_sample_are_there(rate, start):
    time = start + np.arange(101) / 100
    log = recording(A=(time, {"x": 3 * (time - start)}, {}))
    record = gb.prepare(log, {"x": "A.x"}, rate=rate)
    assert len(record) == rate + 1
    assert record.time[[0, -1]] == pytest.approx(time[[0, -1]], abs=1e-6)
    assert np.isfinite(record["x"]).all()
    assert record["x"][[0, -1]] == pytest.approx([0, 3], abs=0.1)


def test_the_rate_is_that_of_the_wanted_stretch():
    """A log that is slow for long, and fast during the test: the samples of the test are all there."""
    time = np.concatenate([np.arange(0, 400, 0.1), np.arange(400, 410, 0.005)])
    log = recording(ATT=(time, {"Pitch": wave(time)}, {}))
    record = gb.prepare(log, {"theta": "ATT.Pitch"}, start=401, end=409)
    assert record.rate == pytest.approx(200)
    assert len(record.pieces) == 1
    assert record["theta"] == pytest.approx(wave(record.time), abs=1e-5)


@pytest.mark.parametrize("samples", [13, 40, 1200])
@pytest.mark.parametrize("rate", [50, 37.0])
def test_a_straight_line_passes_the_filter_as_it_is(samples, rate):
    """Its ends as well, which are extended by reflection in a point; however few samples there are."""
    time = 3 + np.arange(samples) / 400
    record = gb.prepare(recording(A=(time, {"x": 2 - 0.7 * time}, {})), {"x": "A.x"}, rate=rate)
    assert len(record) == int((samples - 1) / 400 * rate + 1e-6) + 1
    assert record["x"] == pytest.approx(2 - 0.7 * record.time, abs=1e-9)


@pytest.mark.parametrize(
    ("share", "kept"), [(0.05, 1), (0.2, 1), (0.345, 1), (0.505, 0), (0.7, 0), (1.3, 0), (3.4, 0)]
)
def test_the_filter_is_flat_to_0_35_of_the_new_rate_and_stops_from_half_of_it(share, kept):
    """By 80 dB; it moves nothing in time."""
    time = stamps(400, 12, start=5.0)
    omega = 2 * np.pi * share * 50
    record = gb.prepare(recording(A=(time, {"x": wave(time, omega)}, {})), {"x": "A.x"}, rate=50)
    inner = slice(60, -60)
    assert record["x"][inner] == pytest.approx(kept * wave(record.time[inner], omega), abs=3e-4)


@pytest.mark.parametrize(("rate", "filtered"), [(96, False), (94, True)])
def test_close_to_the_rate_of_the_log_there_is_no_filter(rate, filtered):
    """From 0.95 of it; a sine at 0.47 of the rate of the log is beyond half of the new one."""
    time = stamps(100, 20)
    log = recording(A=(time, {"x": wave(time, 2 * np.pi * 47.2)}, {}))
    record = gb.prepare(log, {"x": "A.x"}, rate=rate)
    assert (np.abs(record["x"][200:-200]).max() < 0.01) == filtered


@pytest.mark.parametrize("rate", [999.0, 1001.0])
def test_a_rate_is_ten_times_that_of_the_fastest_signal_at_most(rate):
    fast, slow = stamps(100, 2), stamps(20, 2)
    log = recording(A=(fast, {"x": fast}, {}), B=(slow, {"y": slow}, {}))
    if rate > 1000:
        with pytest.raises(
            ValueError,
            match=r"^rate 1001 Hz is more than ten times that of the fastest signal, 100 Hz",
        ):
            gb.prepare(log, {"x": "A.x", "y": "B.y"}, rate=rate)
    else:
        record = gb.prepare(log, {"x": "A.x", "y": "B.y"}, rate=rate)
        assert record["y"] == pytest.approx(record.time, abs=1e-9)


def test_the_grid_is_what_all_signals_have_in_common():
    """From the latest start to the earliest end, or those that are given; a signal of one sample is none."""
    a, b = stamps(50, 10, start=2.0), stamps(20, 10, start=3.5)
    log = recording(A=(a, {"x": a}, {}), B=(b, {"y": b}, {}), C=(b[:1], {"z": b[:1]}, {}))
    signals = {"x": "A.x", "y": "B.y"}
    record = gb.prepare(log, signals, rate=10)
    assert (record.time[0], record.time[-1]) == pytest.approx((3.5, 11.9), abs=1e-9)
    record = gb.prepare(log, signals, rate=10, start=4.25, end=7.0)
    assert (record.time[0], record.time[-1]) == pytest.approx((4.25, 6.95), abs=1e-9)
    record = gb.prepare(log, signals, rate=10, start=-5.0, end=70.0)
    assert (record.time[0], record.time[-1]) == pytest.approx((3.5, 11.9), abs=1e-9)
    for words, sentence in (
        ({"start": np.nan}, "start nan and end inf must be numbers of seconds"),
        ({"end": np.nan}, "start -inf and end nan must be numbers of seconds"),
        (
            {"start": 5.0, "end": 5.05},
            r"do not overlap in time \(A\.x from 2\.0 to 12\.0 s; B\.y from 3\.5 to 13",
        ),
        ({"rate": np.inf}, "rate inf must be a finite number"),
        ({"rate": -1.0}, "rate -1.0 must be a finite number of Hz above 0"),
    ):
        with pytest.raises(ValueError, match=sentence):
            gb.prepare(log, signals, **{"rate": 10, **words})
    with pytest.raises(
        ValueError,
        match=r"C\.z has 1 value in 1 sample, too few for a time base",
    ):
        gb.prepare(log, {"z": "C.z"})


def test_a_lone_sample_between_gaps_is_no_stretch():
    time = np.r_[0:2:0.02, 5.0, 8:10:0.02]
    record = gb.prepare(recording(A=(time, {"x": 3 * time}, {})), {"x": "A.x"}, rate=50)
    assert [len(piece) for piece in record.pieces] == [100, 100]
    assert record["x"] == pytest.approx(3 * record.time)


@pytest.mark.parametrize("samples", [3, 4, 30])
def test_a_parabola_is_interpolated_exactly_from_three_samples_on(samples):
    time = np.arange(samples) / 5
    record = gb.prepare(recording(A=(time, {"x": time**2}, {})), {"x": "A.x"}, rate=20)
    assert record["x"] == pytest.approx(record.time**2, abs=1e-12)


def test_close_samples_do_not_make_a_curve_overshoot():
    """A noisy sine at random times: a spline through them leaves it by tens."""
    random = np.random.default_rng(0)
    time = np.sort(random.uniform(0, 30, 3000))
    x = np.sin(3 * time) + 0.02 * random.normal(size=time.size)
    record = gb.prepare(recording(A=(time, {"x": x}, {})), {"x": "A.x"})
    error = record["x"] - np.sin(3 * record.time)
    assert np.sqrt(np.mean(error**2)) < 0.03
    assert np.abs(error).max() < 0.2


def test_a_signal_is_computed_from_others():
    time = stamps(50, 2)
    log = recording(A=(time, {"x": 2 + time, "y": 3 * time}, {"x": "m", "y": "m"}))
    area = Derived(("A.x", "A.y"), lambda x, y: x * y - x, "m²")
    record = gb.prepare(log, {"a": area}, rate=50)
    assert record["a"] == pytest.approx((2 + record.time) * (3 * record.time - 1))
    assert record.units == {"a": "m²"}
