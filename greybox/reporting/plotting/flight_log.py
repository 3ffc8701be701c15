"""Signals of a flight log over time: a whole log with its tests, and the traces of one test."""

import math
from collections.abc import Sequence

import numpy as np

from greybox.data.clock import clock_of, runs_between_holes
from greybox.data.excited_segment import Segment, Segments, checked_segments
from greybox.data.files.arrays import Array
from greybox.data.files.grouping import grouped
from greybox.data.files.public import public
from greybox.data.record import Record, Recording
from greybox.reporting.plotting.figure import GRAY, Figure, Panel, Series, require_drawable
from greybox.reporting.plotting.long_lines import drawn_line
from greybox.reporting.plotting.matplotlib_figure import AxesArray, GivenAxes, draw
from greybox.reporting.plotting.signals import shown_unit

# Setpoint and angle of each axis, as ArduPilot logs them.
ATTITUDE = (("ATT.DesRoll", "ATT.Roll"), ("ATT.DesPitch", "ATT.Pitch"), ("ATT.DesYaw", "ATT.Yaw"))
ORANGE = 1  # color of tests that are not usable


@public
def traces(
    record: Record,
    segment: Segment | None = None,
    periods: float = 4,
    *,
    axes: GivenAxes | None = None,
) -> AxesArray:
    """Draw every signal of a record over time, one panel for each unit.

    With a `segment`, only its last `periods` periods are drawn, as in the paper's Fig. 3.2:
    setpoint and output share a panel, the control has its own.

    Parameters
    ----------
    record : Record
        Angles are drawn in degrees.
    segment : Segment, optional
        The part to draw.
    periods : float
        Number of periods of the lowest frequency of `segment`.
    axes : array-like of Axes, optional
        One for each unit, in the order of the signals. By default a new figure is made.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
        In a notebook, ``gb.plotting.traces(record)[0].figure`` shows the figure.

    Raises
    ------
    TypeError, ValueError
        If the record has no sample in the segment, or for a wrong number of axes.
    """
    require_drawable(record, Record, "a Record")
    # The last periods: transients have decayed, and the controller has reached the amplitude.
    if segment is not None:
        (segment,) = checked_segments([segment])
        span = min(segment.duration, periods * math.tau / segment.band[0])
        record = record.between(segment.end - span, segment.end)

    # One color for each signal: a panel may contain several.
    colors = {name: k for k, name in enumerate(record.signals)}
    panels = []
    for names in grouped(record.signals, lambda name: record.units.get(name, "")):
        factor, degrees = shown_unit(record.units, names[0])
        series = [
            signal_line(name, record.time, factor * record[name], colors[name]) for name in names
        ]
        panels.append(Panel(f"{', '.join(names)}, {degrees or '-'}", series))

    subject = record.name or "record"
    if segment is not None and segment.kind == "sine":
        subject += f", {segment.omega:.4g} rad/s"
    return draw([Figure("Traces", "Time, s", panels, subject=subject)], axes, size=(9.0, 2.0))


@public
def recording(
    recording: Recording,
    segments: Segments = (),
    *,
    axes: GivenAxes | None = None,
) -> AxesArray:
    """Draw setpoints and angles of a log, or its first signals, with its test segments shaded.

    Parameters
    ----------
    recording : Recording
        A log, as `read` returns it.
    segments : sequence of Segment, optional
        Its tests, as `find_segments` returns them.
    axes : array-like of Axes, optional
        One for each angle of the log, or for each of its first six signals. By default a new
        figure is made.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
        In a notebook, ``gb.plotting.recording(log, tests)[0].figure`` shows the figure.

    Raises
    ------
    TypeError, ValueError
        If there is no signal, or for a wrong number of axes.
    """
    require_drawable(recording, Recording, "the Recording that gb.read returns")
    segments = checked_segments(segments)
    signals = recording.signal_names
    # Without attitudes, more signals would not fit a page.
    names = [
        [name for name in pair if name in signals] for pair in ATTITUDE if pair[1] in signals
    ] or [[name] for name in signals[:6]]
    if not names:
        raise ValueError(f"{recording.source or 'the recording'} has no signal to draw.")

    figure = Figure(
        "Log",
        "Time, s (gray: tests; orange: not usable)" if segments else "Time, s",
        [_panel(recording, signals, 2 * k) for k, signals in enumerate(names)],
        subject=recording.source or "recording",
        spans=[(s.start, s.end, GRAY if s.usable else ORANGE) for s in segments],
    )
    return draw([figure], axes, size=(10.0, 1.8))


def signal_line(name: str, time: Array, values: Array, color: int) -> Series:
    """Return a signal over time; holes of more than ten usual steps interrupt the line."""
    # Raw logs drop single messages: with a smaller limit a lossy log would be dots, not lines.
    clock = clock_of(time)
    x, y = drawn_line(time, values, runs_between_holes(time, clock, 10.0 * clock.step))
    return Series(name, "line", x, y, color)


def _panel(recording: Recording, signals: Sequence[str], color: int) -> Panel:
    series = []
    unit = ""
    for k, signal in enumerate(signals, color):
        record, name = recording.locate(signal)
        unit = record.units.get(name, "")
        # A yaw that passes north would otherwise draw a vertical line from 360 to 0 degrees.
        values = np.unwrap(record[name], period=360) if unit == "deg" else record[name]
        series.append(signal_line(signal, record.time, values, k))
    return Panel(f"{signals[-1]}, {unit or '-'}", series)
