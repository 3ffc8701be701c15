"""Files that bring a test signal to a vehicle: CSV, a Lua script and parameters for ArduPilot."""

import math
from collections.abc import Sequence
from pathlib import Path

from greybox.data.files.delimited_text import write_delimited
from greybox.data.files.public import public
from greybox.data.headings import BETWEEN
from greybox.data.logs.ardupilot.signals import SYSTEMID_AXES
from greybox.data.record import Record
from greybox.modeling.model import require_known
from greybox.workflows.experiment.excitation import Excitation
from greybox.workflows.experiment.sweeps import DWELL

AXES = {"roll": 1, "pitch": 2, "yaw": 3}  # of the SINE message, and the first three of SID_AXIS
# Those that inject into an attitude loop or the mixer.
FLOWN_AXES: Sequence[str] = SYSTEMID_AXES[:13]

# The Lua program that flies the sines; the script sets AXIS, OFFSET, PAUSE and SINES before it.
_SINE_TEST = """local PERIOD_MS = 10 -- between two setpoints
local SWITCH = 300   -- RCx_OPTION: Scripting1
local GUIDED, HIGH, INFO = 4, 2, 6
local W, ETA, SECONDS = 1, 2, 3 -- columns of SINES: rad/s, degrees, s

local segment = 0   -- 0 while waiting
local resting       -- at the operating point, before a sine
local started       -- of the rest or of the sine
local heading = 0   -- kept during the test, degrees
local spent = true  -- the switch has to be low once before a test can start

local function finish(text)
  gcs:send_text(INFO, 'sine test: ' .. text)
  segment = 0
  spent = true
end

local function yaw()
  local known, angle = pcall(function() return ahrs:get_yaw_rad() end) -- named get_yaw before 4.7
  return math.deg(known and angle or ahrs:get_yaw())
end

local function command(angle)
  local target = {0, 0, heading}
  target[AXIS] = target[AXIS] + angle
  return vehicle:set_target_angle_and_climbrate(target[1], target[2], target[3], 0, false, 0)
end

local function enter(number)
  segment, resting, started = number, true, micros()
end

local function fly()
  local t = (micros() - started):tofloat() * 1e-6
  if resting and t >= PAUSE then
    resting, started, t = false, micros(), 0
    if segment > #SINES then return finish('done') end
  end
  if not resting and t >= SINES[segment][SECONDS] then
    enter(segment + 1)
  end
  local sine = 0
  if not resting then
    sine = SINES[segment][ETA] * math.sin(SINES[segment][W] * t)
    logger:write('SINE', 'Seg,Ax,W,Eta,Th0,T,Ref', 'BBfffff', segment, AXIS, SINES[segment][W],
      SINES[segment][ETA], OFFSET, t, sine)
  end
  if not command(OFFSET + sine) then finish('setpoint refused') end
end

local function update()
  local ready = arming:is_armed() and vehicle:get_mode() == GUIDED
  local high = rc:get_aux_cached(SWITCH) == HIGH
  if segment > 0 and not (ready and high) then
    finish('stopped')
  elseif segment > 0 then
    fly()
  elseif not high then
    spent = false
  elseif not spent and ready then
    heading = yaw()
    gcs:send_text(INFO, 'sine test: ' .. #SINES .. ' frequencies')
    enter(1)
  elseif not spent then
    finish('arm and enter GUIDED, then switch again')
  end
  return update, PERIOD_MS
end

return update, 1000
"""


@public
def write_excitation(excitation: Record, path: str | Path) -> None:
    """Write a test signal, or another record, to a CSV file, atomically.

    The header has the units, and where they are known the holds, as `gb.read` reads them:
    ``time [s], u [rad held]``. A hold of a part of a step has no such word and is not written: a
    fit of the file assumes straight lines and says so.

    Raises
    ------
    ValueError
        If a signal is named ``time``.
    """
    if "time" in excitation.signals:
        raise ValueError("the signal 'time' would be read as the time base: give it another name.")
    columns = {"time [s]": excitation.time} if excitation.has_time else {}
    for name, values in excitation.signals.items():
        holds = [word for word, hold in BETWEEN.items() if excitation.hold.get(name) == hold]
        unit = " ".join([excitation.units.get(name, ""), *holds]).strip()
        columns[f"{name} [{unit}]" if unit else name] = values
    write_delimited(Path(path), {}, columns)


@public
def ardupilot_script(excitation: Excitation, axis: str = "pitch") -> str:
    """Return a Lua script that flies a sine schedule with a copter.

    The sines are the angle setpoint in GUIDED mode. The script starts when the switch of
    RCx_OPTION 300 (Scripting1) goes high while the vehicle is armed and in GUIDED, and stops as
    soon as one of the three ends. It logs a SINE message: segment, axis, ω in rad/s, amplitude and
    operating point in degrees, seconds since the segment began, and the sine in degrees. Source of
    the interface: ArduPilot, libraries/AP_Scripting/docs/docs.lua.

    Parameters
    ----------
    excitation : Excitation
        The schedule that `sine_schedule` returns, in rad.
    axis : {"roll", "pitch", "yaw"}

    Raises
    ------
    ValueError
        For an unknown axis, another unit, or anything that is not a sine schedule.
    """
    require_known([axis], AXES, "axis", "the script")
    if any(segment.kind != "sine" for segment in excitation.schedule):
        raise ValueError(
            "the script flies sines only: use sine_schedule(...), or systemid_parameters for a "
            "sweep."
        )
    [unit] = excitation.units.values()
    if unit != "rad":
        raise ValueError(
            f"the setpoint is an angle in rad, but the signal is in {unit or 'no unit'}: give "
            "unit='rad'."
        )

    sines = ", ".join(
        f"{{{s.low:.9g}, {math.degrees(s.amplitude):.9g}, {s.end - s.start:.9g}}}"
        for s in excitation.schedule
    )
    values = {
        "AXIS": AXES[axis],
        "OFFSET": f"{math.degrees(excitation.schedule[0].offset):.9g}",
        "PAUSE": f"{excitation.settings['pause']:.9g}",
        "SINES": f"{{ {sines} }}",
    }
    settings = "".join(f"local {name} = {value}\n" for name, value in values.items())
    return f"-- Sine test on {axis}, made by greybox. {excitation}\n{settings}{_SINE_TEST}"


@public
def systemid_parameters(excitation: Excitation, axis: str) -> str:
    """Return a parameter file that makes ArduPilot's SystemID mode fly this sweep.

    `axis` is where it is added, e.g. "mixer pitch" (see `FLOWN_AXES`); a signal in rad or rad/s is
    converted to degrees, as the vehicle wants it for all but the mixer axes. Source:
    ArduCopter/mode_systemid.cpp.

    Raises
    ------
    ValueError
        For anything else than a logarithmic sweep after two periods of its lowest frequency, or
        values out of the mode's range.
    """
    settings = excitation.settings
    require_known([axis], FLOWN_AXES, "axis", "SystemID mode")
    if settings.get("dwell") != DWELL:
        raise ValueError(
            f"SystemID mode flies logarithmic sweeps after {DWELL} periods only: use "
            "sweep(low, high, ...)."
        )
    for name, limit in (
        ("duration", 255),
        ("fade_in", 20),
        ("fade_out", 5),
    ):  # ranges of SID_T_REC, SID_T_FADE_...
        if settings[name] > limit:
            raise ValueError(
                f"{name} is {settings[name]:g} s, but SystemID mode takes at most {limit} s: "
                "shorten it."
            )
    # SID_AXIS counts from one; zero disables the mode.
    number = FLOWN_AXES.index(axis) + 1
    angular = next(iter(excitation.units.values())).startswith("rad")
    if angular == axis.startswith("mixer"):
        raise ValueError(
            f"the axis {axis!r} needs {'a plain number' if angular else 'rad or rad/s'}: give "
            "sweep(unit=...)."
        )

    values = {
        "AXIS": number,
        "MAGNITUDE": math.degrees(settings["amplitude"]) if angular else settings["amplitude"],
        "F_START_HZ": settings["low"] / math.tau,
        "F_STOP_HZ": settings["high"] / math.tau,
        "T_FADE_IN": settings["fade_in"],
        "T_REC": settings["duration"],
        "T_FADE_OUT": settings["fade_out"],
    }
    return "".join(f"SID_{name},{value:.7g}\n" for name, value in values.items())
