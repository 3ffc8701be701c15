"""Tables of Betaflight's blackbox, as `blackbox_decode` and Blackbox Explorer write them.

The first column is loopIteration, the time is in µs. Explorer writes the settings of the vehicle
before the header. The control of an axis is the sum of the terms of its PID controller.

Sources: https://github.com/betaflight/blackbox-tools, src/blackbox_decode.c; of the firmware,
https://github.com/betaflight/betaflight, the fields in blackbox.c, DEBUG_CHIRP in pid.c and
common/chirp.c, with its debug fields as of pull requests 13105 and 15113.
"""

import re
from dataclasses import replace

import numpy as np

from greybox.data.clock import median_step
from greybox.data.files.arrays import Array
from greybox.data.files.decimal_marks import are_numbers
from greybox.data.files.named_values import Values
from greybox.data.headings import Heading
from greybox.data.intersample import CONTINUOUS, HELD
from greybox.data.record import Record

HEADER = re.compile(rb'^"?loopIteration"?\s*,', re.MULTILINE)
DOUBT = (
    "gyro and setpoint were taken in deg/s: with blackbox_high_resolution, which only the settings "
    "before the header show, they are in 0.1 deg/s, and a gain is ten times too large."
)
TIME, LOOPS = "time", "loopIteration"
GYRO = r"gyro(ADC|Unfilt)\[\d\]"
SETPOINT = r"setpoint\[[0-2]\]"
TERMS = "PIDFS"  # axisS is that of fixed wings
CHIRP = "chirp"
PHASE = 5000  # counts of debug[0] in a radian of the chirp's phase, which is below one turn
TURN = round(2 * np.pi * PHASE)


def without_settings(raw: bytes) -> tuple[bytes, Values]:
    """Return a table whose lines before the header are comments, and the numbers in these lines.

    Line numbers remain correct. Several numbers are named ``rollPID[0]`` and so on.
    """
    header = HEADER.search(raw)
    start = header.start() if header else 0
    lines = raw[:start].split(b"\n")[:-1]
    settings = {}
    for line in lines:
        name, *values = line.decode(errors="replace").strip().replace('"', "").split(",")
        if values and are_numbers(values):
            settings[name] = float(values[0])
            settings |= {f"{name}[{k}]": float(value) for k, value in enumerate(values)}
    return b"".join(b"#" + line + b"\n" for line in lines) + raw[start:], settings


def with_units(headings: list[Heading]) -> list[Heading]:
    """Return the headings with the units that Betaflight does not write."""
    if headings[0].name != LOOPS:
        return headings
    return [h if h.unit else Heading(h.name, _unit(h.name)) for h in headings]


def _unit(name: str) -> str:
    if name == TIME:
        return "us"
    return "deg/s" if re.fullmatch(f"{GYRO}|{SETPOINT}", name) else ""


def completed(record: Record, settings: Values) -> Record:
    """Return the record of a blackbox with the controls, the chirp and the holds of its signals.

    ``axisSum[0]`` to ``axisSum[2]`` are the outputs of the PID controllers, and ``chirp`` is the
    signal that the chirp mode injects into the setpoint of one axis.
    """
    if LOOPS not in record.signals or not record.has_time:
        return record
    signals = dict(record.signals)
    findings = record.findings
    rates = [name for name in signals if re.fullmatch(f"{GYRO}|{SETPOINT}", name)]
    if settings.get("blackbox_high_resolution"):
        # In high resolution, the blackbox logs in tenths of a deg/s.
        signals |= {name: signals[name] / 10 for name in rates if record.units[name] == "deg/s"}
    elif rates and not settings:
        findings += (DOUBT,)

    for axis in range(3):
        # A term whose gain is zero is not logged.
        terms = [name for term in TERMS if (name := f"axis{term}[{axis}]") in signals]
        if terms:
            signals.setdefault(f"axisSum[{axis}]", np.sum([signals[n] for n in terms], axis=0))
    debug = signals.get("debug[0]")
    if debug is not None and _is_phase(debug):
        signals[CHIRP] = np.where(debug > 0, np.cos(debug / PHASE), 0.0)

    # In a thinned log, a value lasted for one pass of the loop and not until the next sample.
    passes = median_step(record[LOOPS])
    period = record.step / passes if passes > 1 else HELD
    hold = {name: CONTINUOUS for name in rates if re.fullmatch(GYRO, name)}
    commanded = rf"axis\w+\[\d\]|{SETPOINT}|{CHIRP}|motor\[\d\]"
    hold |= {name: period for name in signals if re.fullmatch(commanded, name)}
    return replace(record, signals=signals, hold={**record.hold, **hold}, findings=findings)


def _is_phase(debug: Array) -> bool:
    """Return whether a debug field is the phase of a chirp, which rises and starts again."""
    active = debug > 0
    if not np.all((debug >= 0) & (debug <= TURN)) or active.sum() < 100:
        return False
    steps = np.diff(debug)[active[1:] & active[:-1]]
    # Modulo a turn, a phase advances by less than half a turn, up to the Nyquist frequency.
    return bool(debug.max() > 0.9 * TURN and np.mean(steps % TURN < TURN / 2) > 0.8)
