"""Figures of time histories: a whole log with its tests marked, and one sine test as the paper's Fig. 3.2."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from greybox.data.record import Record, Recording
from greybox.data.test_segment import Segment
from greybox.plotting.style import COLORS, page, plain

PAIRS = (("ATT.DesRoll", "ATT.Roll"), ("ATT.DesPitch", "ATT.Pitch"), ("ATT.DesYaw", "ATT.Yaw"))
MOST = 4000  # points of a line: more cannot be told apart on paper
ROWS = 6


def plot_traces(record: Record, segment: Segment | None = None, periods: float = 4) -> Figure:
    """Draw every signal of a record over time, one axes for each unit.

    With a `segment`, only its last `periods` periods are drawn, as in the paper's Fig. 3.2: setpoint and output share
    an axes, the control has its own.

    Raises
    ------
    ValueError
        If the record has no sample in the segment.
    """
    if segment is not None:
        span = min(segment.duration, periods * 2 * math.pi / segment.band[0])
        record = record.between(segment.end - span, segment.end)
    units = list(dict.fromkeys(record.units.get(name, "") for name in record.signals))
    figure = page(9.0, 1.2 + 2.0 * len(units))
    for ax, unit in zip(_rows(figure, len(units)), units, strict=True):
        names = [name for name in record.signals if record.units.get(name, "") == unit]
        for k, name in enumerate(names):
            _line(ax, record.time, record[name] * (180 / math.pi if unit == "rad" else 1), plain(name), k)
        _finish(ax, f"{', '.join(names)}, {'°' if unit == 'rad' else unit or '-'}")
    title = record.name or "record"
    if segment is not None and segment.kind == "sine":
        title += f", {segment.omega:.4g} rad/s"
    figure.axes[0].set_title(plain(title), fontsize=12)
    figure.axes[-1].set_xlabel("Time, s")
    return figure


def plot_recording(recording: Recording, segments: Sequence[Segment] = ()) -> Figure:
    """Draw setpoints and angles of a log, or what signals it has, with its test segments shaded."""
    pairs = [[n for n in pair if _there(recording, n)] for pair in PAIRS if _there(recording, pair[1])]
    if not pairs:
        everything = [f"{key}.{name}" for key, record in recording.items() for name in record.signals]
        pairs = [[name] for name in everything[:ROWS]]
    if not pairs:
        raise ValueError(f"{recording.source or 'the recording'} holds no signal to draw.")
    figure = page(10.0, 1.2 + 1.8 * len(pairs))
    for ax, names in zip(_rows(figure, len(pairs)), pairs, strict=True):
        for k, signal in enumerate(names):
            record, name = recording.locate(signal)
            values = np.unwrap(record[name], period=360) if record.units.get(name) == "deg" else record[name]
            _line(ax, record.time, values, plain(signal), k)
        record, name = recording.locate(names[0])
        for segment in segments:
            ax.axvspan(segment.start, segment.end, color="0.5" if segment.usable else "tab:red", alpha=0.15, lw=0)
        _finish(ax, record.units.get(name, "") or "-")
    figure.axes[0].set_title(plain(recording.source or "recording"), fontsize=12)
    figure.axes[-1].set_xlabel("Time, s (shaded: tests; red: not usable)" if segments else "Time, s")
    return figure


def _there(recording: Recording, signal: str) -> bool:
    try:
        recording.locate(signal)
    except KeyError:
        return False
    return True


def _rows(figure: Figure, count: int) -> Sequence[Axes]:
    return list(np.atleast_1d(figure.subplots(count, 1, sharex=True)))


def _line(ax: Axes, time: np.ndarray, values: np.ndarray, label: str, k: int) -> None:
    """Draw a line with its gaps open, thinned to the extremes of every stretch that a pixel covers."""
    size = -(-time.size // (MOST // 2))
    if size > 2:
        blocks = np.arange(0, time.size - size + 1, size)
        rows = blocks[:, None] + np.arange(size)
        lowest = blocks + np.nan_to_num(values[rows], nan=np.inf).argmin(axis=1)
        highest = blocks + np.nan_to_num(values[rows], nan=-np.inf).argmax(axis=1)
        kept = np.unique(np.concatenate([lowest, highest]))
        time, values = time[kept], values[kept]
    wide = np.flatnonzero(np.diff(time) > 10 * np.median(np.diff(time))) + 1 if time.size > 2 else []
    ax.plot(
        np.insert(time, wide, np.nan), np.insert(values, wide, np.nan), color=COLORS[k % len(COLORS)], linewidth=1.0,
        label=label,
    )  # fmt: skip


def _finish(ax: Axes, label: str) -> None:
    ax.set_ylabel(label)
    ax.grid(color="0.9")
    ax.legend(fontsize=8, loc="upper right")
    ax.spines[["top", "right"]].set_visible(False)
