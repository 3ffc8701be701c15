import csv
import math

import numpy as np
import pytest

from greybox.experiment.excitation import ardupilot_script, sine_schedule, sweep, systemid_parameters, write_excitation

HZ = 2 * math.pi


def test_sine_schedule_repeats_the_simulated_flight():
    """The flights in the simulator lasted so many periods, lead-in of two seconds included."""
    omega = [20.11, 16.01, 12.03, 8.0, 5.34, 4.0, 3.5, 3.0, 2.0, 1.0]
    made = sine_schedule(omega, math.radians(3), offset=math.radians(5))
    periods = [(s.end - s.start) * s.low / (2 * math.pi) for s in made.schedule]
    np.testing.assert_allclose(periods, [56, 45, 33, 23, 15, 12, 12, 11, 11, 11], atol=1e-9)
    assert all(s.settled - s.start >= 2 and s.end - s.settled >= 15 - 1e-9 for s in made.schedule)


def test_sine_schedule_is_the_formula():
    made = sine_schedule([3.0, 1.0], [0.1, 0.2], offset=0.5, rate=200)
    for s in made.schedule:
        inside = (made.time >= s.start) & (made.time < s.end)
        expected = 0.5 + s.amplitude * np.sin(s.low * (made.time[inside] - s.start))
        np.testing.assert_allclose(made["reference"][inside], expected, atol=1e-12)
    assert made["reference"][0] == made["reference"][-1] == 0.5
    assert np.abs(np.diff(made["reference"])).max() < 0.2 * 3.0 / 200  # no jumps
    assert len(made.record()) == made.time.size
    assert "sine on reference" in str(made)


def chirp_cpp(time, magnitude, record, start_hz, stop_hz, fade_in, fade_out):
    """ArduPilot's libraries/AP_Math/chirp.cpp, written down again from its formulas."""
    low, high = HZ * start_hz, HZ * stop_hz
    constant = 2 / start_hz
    rise = math.log(high / low)
    window = np.select(
        [time <= 0, time <= fade_in, time <= record - fade_out, time <= record],
        [
            0,
            0.5 - 0.5 * np.cos(math.pi * time / fade_in),
            1,
            0.5 - 0.5 * np.cos(math.pi * (time - (record - fade_out)) / fade_out + math.pi),
        ],
    )
    late = low * (record - constant) / rise * (np.exp(rise * (time - constant) / (record - constant)) - 1)
    return window * magnitude * np.sin(np.where(time <= constant, low * time - low * constant, late))


def test_logarithmic_sweep_is_the_vehicles():
    made = sweep(HZ * 0.1, HZ * 6, 60, 400, amplitude=0.06)
    np.testing.assert_allclose(made["u"], chirp_cpp(made.time, 0.06, 60, 0.1, 6, 5, 5), atol=1e-9)


@pytest.mark.parametrize("kind", ["logarithmic", "linear"])
def test_sweep_reaches_its_frequencies(kind):
    made = sweep(1.0, 20.0, 60, 200, kind=kind, dwell=0, fade_in=0, fade_out=0)
    crossings = made.time[1:][np.diff(np.sign(made["u"])) != 0]
    frequency = math.pi / np.diff(crossings)
    assert frequency[0] == pytest.approx(1.0, rel=0.15 if kind == "logarithmic" else 0.6)  # rises within the half wave
    assert frequency[-1] == pytest.approx(20.0, rel=0.05)
    middle = np.interp(30, crossings[:-1], frequency)
    assert middle == pytest.approx(math.sqrt(20) if kind == "logarithmic" else 10.5, rel=0.1)


def test_systemid_parameters():
    text = systemid_parameters(sweep(HZ * 0.1, HZ * 6, 60, 400, amplitude=0.06), "mixer pitch")
    values = {name: float(value) for name, value in (line.split(",") for line in text.splitlines())}
    assert values == {
        "SID_AXIS": 11,
        "SID_MAGNITUDE": 0.06,
        "SID_F_START_HZ": pytest.approx(0.1),
        "SID_F_STOP_HZ": pytest.approx(6),
        "SID_T_FADE_IN": 5,
        "SID_T_REC": 60,
        "SID_T_FADE_OUT": 5,
    }
    angle = sweep(1, 10, 60, 100, amplitude=math.radians(2), unit="rad")
    assert "SID_AXIS,2\nSID_MAGNITUDE,2\n" in systemid_parameters(angle, "input pitch")


@pytest.mark.parametrize(
    ("made", "axis", "words"),
    [
        (sweep(1, 10, 60, 100), "pitch", "mixer pitch"),
        (sweep(1, 10, 60, 100, kind="linear"), "mixer pitch", "logarithmic sweeps"),
        (sweep(1, 10, 300, 100), "mixer pitch", "at most 255 s"),
        (sweep(1, 10, 60, 100), "rate pitch", "rad or rad/s"),
        (sine_schedule([1.0], 0.1), "mixer pitch", "use sweep"),
    ],
)
def test_what_the_mode_cannot_fly(made, axis, words):
    with pytest.raises(ValueError, match=words):
        systemid_parameters(made, axis)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: sine_schedule([-1.0], 0.1), "omega is -1 rad/s"),
        (lambda: sine_schedule([], 0.1), "omega is empty"),
        (lambda: sine_schedule([300.0], 0.1), "raise the rate"),
        (lambda: sine_schedule([1.0, 2.0, 3.0], [0.1, 0.2]), "3 frequencies but 2 amplitudes"),
        (lambda: sweep(10, 1, 60, 100), "let it rise"),
        (lambda: sweep(0.1, 10, 60, 100), "too short for 2 periods"),
        (lambda: sweep(1, 10, 60, 100)["theta"], "no signal 'theta'"),
    ],
)
def test_mistakes_are_sentences(make, words):
    with pytest.raises((ValueError, KeyError), match=words):
        make()


def test_csv_comes_back_exactly(tmp_path):
    made = sweep(1, 10, 30, 50, unit="rad/s")
    write_excitation(made, tmp_path / "sweep.csv")
    with (tmp_path / "sweep.csv").open() as file:
        header, *rows = csv.reader(file)
    assert header == ["time_s", "u [rad/s]"]
    np.testing.assert_array_equal(np.array(rows, float).T, [made.time, made["u"]])
    assert [path.name for path in tmp_path.iterdir()] == ["sweep.csv"]


STAND_IN = """
clock, switch, mode, armed, sent, log, texts = 0, 0, 4, true, {}, {}, {}
local count = {}
count.__sub = function(a, b) return setmetatable({v = a.v - b.v}, count) end
count.__index = {tofloat = function(self) return self.v end}
function micros() return setmetatable({v = clock}, count) end
gcs = {send_text = function(_, level, text) table.insert(texts, text) end}
ahrs = {get_yaw = function() return math.rad(30) end}
arming = {is_armed = function() return armed end}
rc = {get_aux_cached = function(_, fn) assert(fn == 300); return switch end}
vehicle = {get_mode = function() return mode end}
function vehicle:set_target_angle_and_climbrate(roll, pitch, yaw, climb, use_rate, rate)
  table.insert(sent, {clock, roll, pitch, yaw}); return true
end
logger = {write = function(_, name, labels, format, ...)
  assert(name == 'SINE' and #format == select('#', ...))
  table.insert(log, {...})
end}
function run(chunk, seconds, events)
  local update, delay = chunk, 0
  while clock < seconds * 1e6 do
    for time, act in pairs(events) do if clock >= time * 1e6 then act(); events[time] = nil end end
    update, delay = update()
    clock = clock + delay * 1000
  end
end
"""


def fly(script, seconds, events):
    """Run the script as ArduPilot does, with a stand-in for the vehicle in the Lua version that ArduPilot has."""
    lua53 = pytest.importorskip("lupa.lua53")
    lua = lua53.LuaRuntime(unpack_returned_tuples=True)
    lua.execute(STAND_IN)
    start = lua.eval("function(text) return assert(load(text)) end")(script)
    table = lua.table_from({t: lua.eval(f"function() {act} end") for t, act in events.items()})
    lua.globals().run(start, seconds, table)

    def rows(name):
        return np.array([list(row.values()) for row in lua.globals()[name].values()], dtype=float)

    return rows("sent"), rows("log"), list(lua.globals().texts.values())


def test_script_flies_the_schedule():
    made = sine_schedule([20.11, 4.0], math.radians(3), offset=math.radians(5))
    sent, log, texts = fly(ardupilot_script(made), 60, {3: "switch = 2"})
    assert texts == ["sine test: 2 frequencies", "sine test: done"]
    time = sent[:, 0] * 1e-6
    assert np.diff(time).max() < 0.0101
    np.testing.assert_array_equal(sent[:, 1], 0)
    np.testing.assert_allclose(sent[:, 3], 30)
    segment, axis, omega, eta, offset, t, reference = log.T
    assert set(axis) == {2}
    assert set(offset.round(6)) == {5}
    np.testing.assert_allclose(reference, eta * np.sin(omega * t), atol=1e-9)
    for number, planned in enumerate(made.schedule, start=1):
        own = segment == number
        assert set(omega[own]) == {planned.low}
        assert t[own].max() == pytest.approx(planned.end - planned.start, abs=0.02)
    resting = sent[(time > time[0] + 0.1) & (time < time[0] + 1.9)]
    np.testing.assert_allclose(resting[:, 2], 5)
    assert np.abs(sent[:, 2] - 5).max() == pytest.approx(3, abs=0.03)


@pytest.mark.parametrize("act", ["switch = 0", "mode = 5", "armed = false"])
def test_script_gives_up_at_once_and_does_not_resume(act):
    script = ardupilot_script(sine_schedule([4.0], 0.05))
    back = {"switch = 0": "mode = 4", "mode = 5": "mode = 4", "armed = false": "armed = true"}[act]
    sent, _, texts = fly(script, 30, {2: "switch = 2", 10: act, 12: back})
    assert texts[-1] == "sine test: stopped"
    assert sent[-1, 0] * 1e-6 == pytest.approx(10, abs=0.02)


def test_script_waits_for_the_switch_to_be_low():
    script = ardupilot_script(sine_schedule([4.0], 0.05))
    assert not fly(script, 10, {0: "switch = 2"})[0].size  # high since power on
    sent, _, texts = fly(script, 10, {0: "mode = 5", 2: "switch = 2", 4: "mode = 4"})
    assert not sent.size
    assert texts == ["sine test: arm and enter GUIDED, then switch again"]


@pytest.mark.parametrize(
    ("made", "axis", "words"),
    [
        (sweep(1, 10, 60, 100), "pitch", "sines only"),
        (sine_schedule([1.0], 0.1), "heave", "roll, pitch, yaw"),
        (sine_schedule([1.0], 0.1, unit="deg"), "pitch", "in deg"),
    ],
)
def test_what_the_script_cannot_fly(made, axis, words):
    with pytest.raises(ValueError, match=words):
        ardupilot_script(made, axis)
