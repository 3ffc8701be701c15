"""Test signals: sine schedules (3.14) and frequency sweeps, as numbers and for the vehicle."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from greybox.data.record import Record
from greybox.data.safe_files import write_text
from greybox.data.text_table import one_line

Array = NDArray[np.float64]
AXES = {"roll": 1, "pitch": 2, "yaw": 3}  # of the SINE message, and the first three of SID_AXIS
# SID_AXIS, https://ardupilot.org/copter/docs/parameters.html
SYSTEMID_AXES = (
    "input roll,input pitch,input yaw,recovery roll,recovery pitch,recovery yaw,"
    "rate roll,rate pitch,rate yaw,mixer roll,mixer pitch,mixer yaw,mixer thrust"
).split(",")
DWELL = 2  # periods of the lowest frequency before a sweep: ArduPilot's SystemID mode; Tischler and Remple, section 5.6


class Segment(NamedTuple):
    """A stretch of one kind of excitation: signal name, times in s, angular frequencies in rad/s, the signal's unit.

    `settled` is where the part to be analyzed begins.
    """

    signal: str
    kind: str
    start: float
    settled: float
    end: float
    low: float
    high: float
    amplitude: float
    offset: float


@dataclass(frozen=True, eq=False)
class Excitation:
    """A test signal to be flown, or several at once.

    Attributes
    ----------
    time : (n,) array, s, from 0 and uniform
    signals : mapping of name to (n,) array
    units : mapping of name to str
    rate : float, Hz
    schedule : tuple of Segment
    settings : mapping
        What the signal was made from; for a multisine also its ``harmonics`` (name to multiples of 2π / ``period``).
    """

    time: Array
    signals: Mapping[str, Array]
    units: Mapping[str, str]
    rate: float
    schedule: tuple[Segment, ...]
    settings: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for values in (self.time, *self.signals.values()):
            values.setflags(write=False)
        for name in ("signals", "units", "settings"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def __getitem__(self, name: str) -> Array:
        if name not in self.signals:
            raise KeyError(f"the excitation has no signal {name!r}; it has {', '.join(self.signals)}.")
        return self.signals[name]

    @property
    def peak_factors(self) -> dict[str, float]:
        """Peak to peak over 2√2 root mean squares about the mean, 1 for a sine (Morelli's relative peak factor)."""
        return {name: float(np.ptp(v) / (2 * math.sqrt(2) * np.std(v))) for name, v in self.signals.items()}

    def record(self) -> Record:
        """Return the signals as a `Record`, e.g. to simulate what they will do."""
        return Record(self.time, self.signals, self.units, name="excitation", metadata={"schedule": self.schedule})

    def __repr__(self) -> str:
        return one_line(self, ", ".join(self.signals), f"{self.time.size / self.rate:.4g} s at {self.rate:g} Hz")

    def __str__(self) -> str:
        kinds = sorted({segment.kind for segment in self.schedule})
        low, high = min(s.low for s in self.schedule), max(s.high for s in self.schedule)
        return (
            f"{', '.join(kinds)} on {', '.join(self.signals)}: {self.time.size / self.rate:.1f} s at {self.rate:g} Hz, "
            f"{low:.4g} to {high:.4g} rad/s, peak factor {', '.join(f'{v:.2f}' for v in self.peak_factors.values())}"
        )


def sine_schedule(  # noqa: PLR0913 - each is one fact of the test card
    omega: Sequence[float],
    amplitude: float | Sequence[float],
    *,
    offset: float = 0.0,
    periods: int = 10,
    least: float = 15.0,
    lead_in: float = 2.0,
    pause: float = 2.0,
    rate: float = 100.0,
    signal: str = "reference",
    unit: str = "rad",
) -> Excitation:
    """One sine after another about an operating point, (3.14): offset + η_i sin(ω_i (t - t_0)).

    Parameters
    ----------
    omega : (n,) sequence, rad/s, in the order in which they are flown
    amplitude : float or (n,) sequence
        η_i, in the signal's unit.
    offset : float, the operating point
    periods, least : int and s
        A sine lasts `periods` periods or `least` seconds, whichever is longer, rounded up to whole periods.
    lead_in, pause : s
        Of the same sine before that, in whole periods, to settle; and at the operating point before and after each.
    rate : Hz
    signal, unit : str

    Raises
    ------
    ValueError
        For frequencies that are not between 0 and a fifth of the sampling rate, or numbers that do not match.
    """
    frequencies = checked_band(omega, rate)
    heights = np.atleast_1d(np.asarray(amplitude, dtype=float))
    if heights.size not in (1, frequencies.size):
        raise ValueError(f"there are {frequencies.size} frequencies but {heights.size} amplitudes: give one for each.")
    heights = np.broadcast_to(heights, frequencies.shape)
    schedule, clock = [], pause
    for w, eta in zip(frequencies.tolist(), heights.tolist(), strict=True):
        period = 2 * math.pi / w
        lead = _whole(lead_in / period) * period
        length = max(periods, _whole(least / period)) * period
        schedule.append(Segment(signal, "sine", clock, clock + lead, clock + lead + length, w, w, eta, offset))
        clock += lead + length + pause
    time = np.arange(_whole(clock * rate) + 1) / rate
    values = np.full(time.size, float(offset))
    for s in schedule:
        inside = (time >= s.start) & (time < s.end)
        values[inside] += s.amplitude * np.sin(s.low * (time[inside] - s.start))
    return Excitation(time, {signal: values}, {signal: unit}, rate, tuple(schedule), {"pause": pause})


def sweep(  # noqa: PLR0913 - each is one fact of the test card
    low: float,
    high: float,
    duration: float,
    rate: float,
    *,
    amplitude: float = 1.0,
    kind: Literal["logarithmic", "linear"] = "logarithmic",
    fade_in: float = 5.0,
    fade_out: float = 5.0,
    dwell: int = DWELL,
    signal: str = "u",
    unit: str = "",
) -> Excitation:
    """Make a frequency sweep from `low` to `high`, faded in and out with half cosines.

    It begins with `dwell` periods of the lowest frequency, which count to the duration. The logarithmic one is, sample
    for sample, the signal of ArduPilot's SystemID mode (libraries/AP_Math/chirp.cpp).

    Parameters
    ----------
    low, high : rad/s
    duration, fade_in, fade_out : s
    rate : Hz
    amplitude : in the signal's unit
    kind : {"logarithmic", "linear"}
        Equal time per octave, or per rad/s.
    dwell : int
    signal, unit : str

    Raises
    ------
    ValueError
        For a band that is empty or above a fifth of the sampling rate, or a duration too short for dwell and fades.
    """
    checked_band([low, high], rate)
    if low >= high or kind not in ("logarithmic", "linear"):
        raise ValueError(f"a {kind!r} sweep from {low:g} to {high:g} rad/s: let it rise, 'logarithmic' or 'linear'.")
    hold = dwell * 2 * math.pi / low
    if min(fade_in, fade_out) < 0 or duration < fade_in + fade_out or duration <= hold:
        raise ValueError(
            f"{duration:g} s are too short for {dwell} periods at {low:g} rad/s ({hold:.1f} s) and fades of "
            f"{fade_in:g} and {fade_out:g} s: raise the duration or the lowest frequency, or give dwell=0."
        )
    time = np.arange(_whole(duration * rate) + 1) / rate
    span = duration - hold
    late = np.maximum(time - hold, 0)
    if kind == "logarithmic":
        rise = math.log(high / low)
        phase = low * span / rise * np.expm1(rise * late / span)
    else:
        phase = low * late + (high - low) * late**2 / (2 * span)
    values = amplitude * _fades(time, duration, fade_in, fade_out) * np.sin(phase + low * np.minimum(time - hold, 0))
    settings = {"low": low, "high": high, "duration": duration, "kind": kind, "amplitude": amplitude}
    settings |= {"fade_in": fade_in, "fade_out": fade_out, "dwell": dwell}
    part = Segment(signal, f"{kind} sweep", 0.0, 0.0, duration, low, high, amplitude, 0.0)
    return Excitation(time, {signal: values}, {signal: unit}, rate, (part,), settings)


def write_excitation(excitation: Excitation, path: str | Path) -> None:
    """Write time in s and the signals to a CSV file, which appears complete or not at all."""
    header = [
        "time_s",
        *(f"{n} [{u}]" if (u := excitation.units[n]) else n for n in excitation.signals),
    ]
    rows = zip(excitation.time, *excitation.signals.values(), strict=True)
    lines = [",".join(header), *(",".join(repr(float(v)) for v in row) for row in rows)]
    write_text(Path(path), "\n".join(lines) + "\n")


def ardupilot_script(excitation: Excitation, axis: str = "pitch", *, period_ms: int = 10, switch: int = 300) -> str:
    """Return a Lua script that flies a sine schedule as the angle setpoint of a copter in GUIDED mode.

    It starts when the switch of RCx_OPTION `switch` (300 is Scripting1) goes high while the vehicle is armed and in
    GUIDED, and gives up as soon as one of the three ends. It logs a SINE message: segment, axis, ω in rad/s, amplitude
    and operating point in degrees, seconds since the segment began, and the sine in degrees. Source of the interface:
    ArduPilot, libraries/AP_Scripting/docs/docs.lua.

    Parameters
    ----------
    excitation : Excitation
        Of `sine_schedule`, in rad.
    axis : {"roll", "pitch", "yaw"}
    period_ms : between two setpoints, ms
    switch : int

    Raises
    ------
    ValueError
        For an unknown axis, another unit, or anything that is not a sine schedule.
    """
    if axis not in AXES:
        raise ValueError(f"the axis {axis!r} is not known: use one of {', '.join(AXES)}.")
    if any(segment.kind != "sine" for segment in excitation.schedule):
        raise ValueError("the script flies sines only: use sine_schedule(...), or systemid_parameters for a sweep.")
    unit = next(iter(excitation.units.values()))
    if unit != "rad":
        raise ValueError(f"the setpoint is an angle in rad, but the signal is in {unit or 'no unit'}: give unit='rad'.")
    sines = ", ".join(
        f"{{{s.low:.9g}, {math.degrees(s.amplitude):.9g}, {s.end - s.start:.9g}}}" for s in excitation.schedule
    )
    values = {
        "AXIS": AXES[axis],
        "OFFSET": f"{math.degrees(excitation.schedule[0].offset):.9g}",
        "PAUSE": f"{excitation.settings['pause']:.9g}",
        "PERIOD_MS": int(period_ms),
        "SWITCH": int(switch),
        "SINES": f"{{ {sines} }}",
    }
    settings = "".join(f"local {name} = {value}\n" for name, value in values.items())
    return f"-- Sine test on {axis}, made by greybox. {excitation}\n{settings}{_SCRIPT}"


def systemid_parameters(excitation: Excitation, axis: str) -> str:
    """Return a parameter file that makes ArduPilot's SystemID mode fly this sweep.

    `axis` is where it is added, e.g. "mixer pitch" (see `SYSTEMID_AXES`); a signal in rad or rad/s is converted to
    degrees, as the vehicle wants it for all but the mixer axes. Source: ArduCopter/mode_systemid.cpp.

    Raises
    ------
    ValueError
        For anything else than a logarithmic sweep after two periods of its lowest frequency, or values out of the
        mode's range.
    """
    have = excitation.settings
    if axis not in SYSTEMID_AXES:
        raise ValueError(f"the axis {axis!r} is not known: use one of {', '.join(SYSTEMID_AXES)}.")
    if have.get("kind") != "logarithmic" or have.get("dwell") != DWELL:
        raise ValueError(
            f"SystemID mode flies logarithmic sweeps after {DWELL} periods only: use sweep(low, high, ...)."
        )
    for name, limit in (("duration", 255), ("fade_in", 20), ("fade_out", 5)):
        if have[name] > limit:
            raise ValueError(f"{name} is {have[name]:g} s, but SystemID mode takes at most {limit} s: shorten it.")
    number = SYSTEMID_AXES.index(axis) + 1
    angular = next(iter(excitation.units.values())).startswith("rad")
    if angular == axis.startswith("mixer"):
        raise ValueError(
            f"the axis {axis!r} needs {'a plain number' if angular else 'rad or rad/s'}: give sweep(unit=...)."
        )
    values = {
        "AXIS": number,
        "MAGNITUDE": math.degrees(have["amplitude"]) if angular else have["amplitude"],
        "F_START_HZ": have["low"] / (2 * math.pi),
        "F_STOP_HZ": have["high"] / (2 * math.pi),
        "T_FADE_IN": have["fade_in"],
        "T_REC": have["duration"],
        "T_FADE_OUT": have["fade_out"],
    }
    return "".join(f"SID_{name},{value:.7g}\n" for name, value in values.items())


def _whole(value: float) -> int:
    """Round up, forgiving rounding errors."""
    return math.ceil(value - 1e-9)


def checked_band(omega: Sequence[float], rate: float) -> Array:
    """Return the frequencies, rad/s, once they are known to be above 0 and well below the sampling rate."""
    values = np.asarray(omega, dtype=float)
    limit = 2 * math.pi * rate / 5
    bad = values[~((values > 0) & (values <= limit))]
    if values.size == 0 or bad.size:
        raise ValueError(
            f"omega is {f'{bad[0]:g} rad/s' if bad.size else 'empty'}: give frequencies above 0 and up to {limit:.4g} "
            f"rad/s, a fifth of the sampling rate of {rate:g} Hz, or raise the rate."
        )
    return values


def _fades(time: Array, duration: float, fade_in: float, fade_out: float) -> Array:
    """Half cosines at both ends."""
    window = np.ones(time.size)
    if fade_in > 0:
        window *= 0.5 - 0.5 * np.cos(math.pi * np.minimum(time / fade_in, 1))
    if fade_out > 0:
        window *= 0.5 - 0.5 * np.cos(math.pi * np.clip((duration - time) / fade_out, 0, 1))
    return window


_SCRIPT = """local GUIDED, HIGH, INFO = 4, 2, 6
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
    logger:write('SINE', 'Seg,Ax,W,Eta,Th0,T,Ref', 'BBfffff', segment, AXIS, SINES[segment][W], SINES[segment][ETA],
      OFFSET, t, sine)
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
