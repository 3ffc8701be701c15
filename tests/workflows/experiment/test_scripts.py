import csv
import math
from dataclasses import replace

import numpy as np
import pytest

import greybox as gb
from greybox.workflows.experiment.multisines import multisine
from greybox.workflows.experiment.scripts import (
    ardupilot_script,
    systemid_parameters,
    write_excitation,
)
from greybox.workflows.experiment.sine_schedules import sine_schedule
from greybox.workflows.experiment.sweeps import sweep

HZ = 2 * math.pi


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
        (sweep(1, 10, 60, 100, dwell=0), "mixer pitch", "logarithmic sweeps"),
        (sweep(1, 10, 300, 100), "mixer pitch", "at most 255 s"),
        (sweep(1, 10, 60, 100), "rate pitch", "rad or rad/s"),
        (sine_schedule([1.0], 0.1), "mixer pitch", "use sweep"),
    ],
)
def test_what_the_mode_cannot_fly(made, axis, words):
    with pytest.raises(ValueError, match=words):
        systemid_parameters(made, axis)


def test_csv_comes_back_exactly(tmp_path):
    made = sweep(1, 10, 30, 50, unit="rad/s")
    write_excitation(made, tmp_path / "sweep.csv")
    with (tmp_path / "sweep.csv").open() as file:
        header, *rows = csv.reader(file)
    assert header == ["time [s]", "u [rad/s]"]
    np.testing.assert_array_equal(np.array(rows, float).T, [made.time, made["u"]])
    assert [path.name for path in tmp_path.iterdir()] == ["sweep.csv"]


def test_units_and_holds_come_back(tmp_path):
    made = multisine(1, 20, 10, 50, signals=("u", "v", "w"), unit="N")
    hold = {"u": math.inf, "v": 0.0}
    write_excitation(replace(made, hold=hold), tmp_path / "three.csv")
    [record] = gb.read(tmp_path / "three.csv").values()
    assert record.hold == hold
    assert record.units == made.units
    rows = gb.Record(None, {"v": np.ones(3)})
    write_excitation(rows, tmp_path / "rows.csv")
    [record] = gb.read(tmp_path / "rows.csv").values()
    assert not record.has_time


def test_a_signal_that_would_be_read_as_the_time_base_is_refused(tmp_path):
    record = gb.Record([0.0, 1.0], {"time": [3.0, 4.0]})
    with pytest.raises(ValueError, match="'time' would be read as the time base"):
        write_excitation(record, tmp_path / "u.csv")


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


@pytest.mark.parametrize(("axis", "number"), [("roll", 1), ("pitch", 2), ("yaw", 3)])
def test_the_script_turns_its_own_axis(axis, number):
    assert f"AXIS = {number}" in ardupilot_script(
        sine_schedule([1.0], 0.1, unit="rad"), axis
    ).replace("local ", "")


@pytest.mark.parametrize(("name", "most"), [("duration", 255), ("fade_in", 20), ("fade_out", 5)])
def test_times_of_a_sweep_may_be_as_long_as_the_mode_takes(name, most):
    made = sweep(1, 10, 60, 100)
    assert "SID_AXIS" in systemid_parameters(
        replace(made, settings={**made.settings, name: most}), "mixer pitch"
    )
    longer = replace(made, settings={**made.settings, name: most + 0.5})
    with pytest.raises(
        ValueError,
        match=rf"^{name} is {most}\.5 s, but SystemID mode takes at most {most} s: shorten it",
    ):
        systemid_parameters(longer, "mixer pitch")
