"""Signals of a flight log over time: the whole log with its tests marked, and one sine test as the paper's Fig. 3.2."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from greybox.data.record import Record, Recording
from greybox.data.test_segment import Segment
from greybox.plotting.long_lines import drawn_line, pieces
from greybox.plotting.style import (
    TITLE_SIZE,
    AxesArray,
    GivenAxes,
    color_of,
    finish,
    label_horizontal,
    plain,
    shade_tests,
    shown_unit,
    stacked_axes,
)

# Setpoint and angle of each axis, as ArduPilot logs them.
ATTITUDE = (("ATT.DesRoll", "ATT.Roll"), ("ATT.DesPitch", "ATT.Pitch"), ("ATT.DesYaw", "ATT.Yaw"))
PANELS = 6  # signals of a log without attitudes that are drawn; more would not fit a page
GAP = 10.0  # median steps: raw logs drop single messages, which would leave dots instead of lines


def traces(
    record: Record,
    segment: Segment | None = None,
    periods: float = 4,
    *,
    axes: GivenAxes | None = None,
    legend: bool = True,
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
        How many periods of the lowest frequency of `segment`.
    axes : array-like of Axes, optional
        One for each unit, in the order of the signals. Without it a new figure is made.
    legend : bool
        False leaves the legends inside the panels out.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
        The last line of a notebook cell is ``gb.plotting.traces(record)[0].figure``.

    Raises
    ------
    TypeError, ValueError
        If the record has no sample in the segment, or for a wrong number of axes.
    """
    if segment is not None:
        span = min(segment.duration, periods * 2 * math.pi / segment.band[0])
        record = record.between(segment.end - span, segment.end)
    units = list(dict.fromkeys(record.units.get(name, "") for name in record.signals))
    drawn = stacked_axes(
        axes, [unit or "no unit" for unit in units], "this record", 9.0, 1.2 + 2.0 * len(units)
    )

    for ax, unit in zip(drawn, units, strict=True):
        names = [name for name in record.signals if record.units.get(name, "") == unit]
        scale, shown = shown_unit(unit)
        for k, name in enumerate(names):
            _line(ax, record.time, scale * record[name], plain(name), k)
        finish(ax, plain(f"{', '.join(names)}, {shown or '-'}"), legend)

    text = record.name or "record"
    if segment is not None and segment.kind == "sine":
        text += f", {segment.omega:.4g} rad/s"
    drawn[0].set_title(plain(text), fontsize=TITLE_SIZE)
    label_horizontal(drawn, "Time, s")
    return drawn


def recording(
    recording: Recording,
    segments: Sequence[Segment] = (),
    *,
    axes: GivenAxes | None = None,
    legend: bool = True,
) -> AxesArray:
    """Draw setpoints and angles of a log, or what signals it has, with its test segments shaded.

    Parameters
    ----------
    recording : Recording
        A log, as `read` returns it.
    segments : sequence of Segment, optional
        Its tests, as `find_segments` returns them.
    axes : array-like of Axes, optional
        One for each angle of the log, or for each of its first six signals. Without it a new figure
        is made.
    legend : bool
        False leaves the legends inside the panels out.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
        The last line of a notebook cell is ``gb.plotting.recording(log, tests)[0].figure``.

    Raises
    ------
    TypeError, ValueError
        If there is no signal, or for a wrong number of axes.
    """
    panels = [
        [n for n in pair if _holds(recording, n)] for pair in ATTITUDE if _holds(recording, pair[1])
    ]
    if not panels:
        everything = [
            f"{key}.{name}" for key, record in recording.items() for name in record.signals
        ]
        panels = [[name] for name in everything[:PANELS]]
    if not panels:
        raise ValueError(f"{recording.source or 'the recording'} holds no signal to draw.")
    drawn = stacked_axes(
        axes, [names[-1] for names in panels], "this log", 10.0, 1.2 + 1.8 * len(panels)
    )

    for ax, names in zip(drawn, panels, strict=True):
        for k, signal in enumerate(names):
            record, name = recording.locate(signal)
            values = (
                np.unwrap(record[name], period=360)
                if record.units.get(name) == "deg"
                else record[name]
            )
            _line(ax, record.time, values, plain(signal), k)
        shade_tests(ax, segments)
        record, name = recording.locate(names[0])
        finish(ax, plain(record.units.get(name, "") or "-"), legend)

    drawn[0].set_title(plain(recording.source or "recording"), fontsize=TITLE_SIZE)
    label_horizontal(drawn, "Time, s (shaded: tests; red: not usable)" if segments else "Time, s")
    return drawn


def _holds(recording: Recording, signal: str) -> bool:
    try:
        recording.locate(signal)
    except KeyError:
        return False
    return True


def _line(ax: Axes, time: np.ndarray, values: np.ndarray, label: str, k: int) -> None:
    gap = GAP * float(np.median(np.diff(time))) if time.size > 2 else math.inf
    ax.plot(
        *drawn_line(time, values, pieces(time, gap)), color=color_of(k), linewidth=1.0, label=label
    )
