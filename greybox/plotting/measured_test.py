"""A measurement from a log as one figure: signals, spectrogram or sines, and the response before and after corrections.

Begin with `measurement`. `spectrogram` and `demodulated` draw one test of a record.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure, SubFigure

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record, Recording
from greybox.data.test_segment import Segment
from greybox.identification.identify import filter_model
from greybox.identification.measurement import Measurement
from greybox.logs.ardupilot.motors import limits, motor_outputs
from greybox.modeling.linear_response import frequency_response
from greybox.plotting.bode import bode_axes, bode_height, bode_panels, draw_bode
from greybox.plotting.long_lines import drawn_line, pieces
from greybox.plotting.response_series import legend_entries, response_series
from greybox.plotting.style import (
    DARK,
    TITLE_SIZE,
    AxesArray,
    GivenAxes,
    color_of,
    finish,
    label_horizontal,
    legend_below,
    new_figure,
    plain,
    shade_tests,
    shown_unit,
    signal_label,
    stacked_axes,
    symbol,
)
from greybox.spectral.demodulation import least_squares, whole_periods
from greybox.spectral.saturation import at_limit

WIDTH, BODE_WIDTH, PANEL, SINES, SPECTRUM = 8.2, 6.2, 1.25, 1.6, 2.6  # inches

# Of the duration of a sweep, a window of its spectrogram: a logarithmic sweep over two decades
# passes a quarter of an octave in it, and the window holds two periods of 2π/10 of the lowest
# frequencies that such sweeps begin with.
WINDOW = 0.05
DYNAMIC = 60.0  # dB, shown below the strongest
PERIODS = 4.0  # of a sine that are shown: in more, raw values and sine lie on one another
LIMIT = "#D55E00"  # of what is at its limit


def measurement(measured: Measurement, recording: Recording | None = None) -> Figure:
    """Draw what was measured from a log.

    Input, output and instrument over time, each on an axis of its own, with the tests shaded and
    what is at a limit marked; with the `recording` the outputs of the motors too, where it has
    them. Below them the spectrogram of a sweep, or the demodulated sine over the raw signals for
    the test with the largest error. Beside them the response with coherence and error bars, and,
    where the output has passed known filters, the response without them.

    Parameters
    ----------
    measured : Measurement
    recording : Recording, optional
        The log that it was measured from.

    Returns
    -------
    Figure
        It is not known to pyplot: show it as the last line of a notebook cell, or save it with
        ``savefig``.
    """
    record = measured.record
    names = list(record.signals)
    motors = (
        None
        if recording is None
        else motor_outputs(recording, float(record.time[0]), float(record.time[-1]))
    )
    sines = [s for s in measured.used if s.kind == "sine"]
    rows = len(names) + (motors is not None)
    below = SINES * min(len(names), 2) if sines else SPECTRUM
    left_height = PANEL * rows + below + 0.9
    responses, labels = _responses(measured)
    series = response_series(responses, labels) if responses else []
    panels = bode_panels(series, []) if series else []
    height = max(left_height, bode_height(panels) if panels else 0)
    figure = new_figure(WIDTH + (BODE_WIDTH if panels else 0), height)
    figure.suptitle(plain(record.name or "measurement"), fontsize=13)
    parts = figure.subfigures(
        1, 2 if panels else 1, width_ratios=(WIDTH, BODE_WIDTH)[: 2 if panels else 1], squeeze=False
    )
    left = parts[0, 0]
    upper, lower = left.subfigures(
        2, 1, height_ratios=(PANEL * rows + 0.5, below + 0.4), squeeze=False
    )[:, 0]

    axes = upper.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    for k, (ax, name) in enumerate(zip(axes, names, strict=False)):
        _draw_signal(ax, record, name, measured.tests, color_of(k), limited=k == 0)
    if motors is not None and recording is not None:
        _draw_motors(
            axes[-1], motors, limits(recording.metadata.get("parameters", {})), measured.tests
        )
    label_horizontal(axes, "Time, s (shaded: tests; marked: at a limit)")
    upper.align_ylabels(axes)
    _draw_test(lower, measured, sines)

    if panels:
        right = parts[0, 1]
        drawn = bode_axes(right, panels)
        draw_bode(drawn, panels, series, [], "Measured response")
        right.align_ylabels(drawn)
        if len(responses) > 1:
            legend_below(right, legend_entries(series))
    return figure


def spectrogram(
    record: Record, signal: str, segment: Segment | None = None, *, ax: Axes | None = None
) -> Axes:
    """Draw the power of a signal over time and frequency.

    Parameters
    ----------
    record : Record
        On a uniform time base, as `prepare` makes it; of several pieces the longest is drawn.
    signal : str
    segment : Segment, optional
        The test to draw, with its frequencies; by default the whole record.
    ax : Axes, optional

    Returns
    -------
    Axes

    Raises
    ------
    KeyError, ValueError
        For a signal or a segment that the record does not hold.
    """
    from scipy.signal import spectrogram as power  # noqa: PLC0415  (takes a third of a second to import)

    part = record if segment is None else record.between(segment.start, segment.end)
    part = max(part.pieces, key=len)
    values = part[signal] - part[signal].mean()
    count = int(np.clip(WINDOW * len(part), 16, len(part)))
    if count > len(part) or len(part) < 32:
        raise ValueError(
            f"{len(part)} samples of {signal!r} are too few for a spectrogram: give a longer stretch."
        )
    hz, times, density = power(
        values, part.rate, "hann", count, count * 7 // 8, nfft=4 * count, detrend="linear"
    )
    ax = new_figure(8.0, 3.0).subplots() if ax is None else ax
    omega = 2 * np.pi * hz[1:]
    density = np.maximum(density[1:], 1e-300)
    top = float(density.max())
    image = ax.pcolormesh(
        part.time[0] + times,
        omega,
        density,
        norm=LogNorm(top * 10 ** (-DYNAMIC / 10), top),
        cmap="viridis",
        shading="nearest",
        rasterized=True,
    )
    low, high = (
        (omega[0], omega[-1]) if segment is None else (segment.band[0] / 1.5, segment.band[1] * 2)
    )
    ax.set_yscale("log")
    ax.set_ylim(max(low, omega[0]), min(high, omega[-1]))
    finish(ax, "ω, rad/s")
    ax.figure.colorbar(image, ax=ax, label=f"Power of {symbol(signal)}", pad=0.01)
    label_horizontal([ax], "Time, s")
    return ax


def demodulated(
    record: Record,
    segment: Segment,
    signals: Sequence[str],
    *,
    axes: GivenAxes | None = None,
    legend: bool = True,
) -> AxesArray:
    """Draw the last periods of a sine test: the raw signals and the sine, mean and trend that were fitted to each.

    Parameters
    ----------
    record : Record
        Angles are drawn in degrees.
    segment : Segment
        A sine.
    signals : sequence of str
    axes : array-like of Axes, optional
        One for each signal. Without it a new figure is made.
    legend : bool
        False leaves the legend inside the first panel out.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)

    Raises
    ------
    KeyError, ValueError
        For a signal that is not there, a test that is no sine, or one without a whole period.
    """
    if segment.kind != "sine":
        raise ValueError(f"the test is a {segment.kind}: give a sine, or draw its spectrogram.")
    part = record.between(segment.start, segment.end)
    rows, _ = whole_periods(part.time, segment.omega, 0.0, None)
    time = part.time[rows]
    drawn = stacked_axes(axes, list(signals), "this test", 8.0, 0.8 + SINES * len(signals))
    shown = time >= time[-1] - PERIODS * 2 * math.pi / segment.omega
    for k, (ax, name) in enumerate(zip(drawn, signals, strict=True)):
        unit = record.units.get(name, "")
        x = shown_unit(unit)[0] * part[name][rows]
        amplitude, drift, _ = least_squares(time, x[None], segment.omega, float(time[0]), 1)
        phase = segment.omega * (time - time[0])
        line = x.mean() + drift[0] * (time - time.mean()) / (time[-1] - time[0])
        sine = line + amplitude[0, 0].real * np.sin(phase) + amplitude[0, 0].imag * np.cos(phase)
        ax.plot(time[shown], x[shown], ".", ms=3, color=color_of(k), label="raw")
        ax.plot(time[shown], sine[shown], color=DARK, lw=1.2, label="demodulated")
        finish(ax, signal_label(name, unit))
    if legend:
        drawn[0].legend(fontsize=8, loc="upper right", ncols=2)
    label_horizontal(drawn, "Time, s")
    return drawn


def _draw_signal(
    ax: Axes, record: Record, name: str, tests: Sequence[Segment], color: str, *, limited: bool
) -> None:
    unit = record.units.get(name, "")
    values = record[name] * shown_unit(unit)[0]
    ax.plot(
        *drawn_line(record.time, values, pieces(record.time, 2.5 * record.step)),
        color=color,
        linewidth=0.8,
    )
    shade_tests(ax, tests)
    if limited:
        rows = at_limit(record[name])
        ax.plot(record.time[rows], values[rows], "|", color=LIMIT, ms=8)
    finish(ax, signal_label(name, unit))


def _draw_motors(
    ax: Axes, motors: Record, ends: tuple[float, float], tests: Sequence[Segment]
) -> None:
    for k, values in enumerate(motors.signals.values()):
        ax.plot(
            *drawn_line(motors.time, values, pieces(motors.time, 10 * motors.step)),
            color=color_of(k),
            lw=0.8,
        )
        rows = (values <= ends[0]) | (values >= ends[1] - 1)
        ax.plot(motors.time[rows], values[rows], "|", color=LIMIT, ms=8)
    shade_tests(ax, tests)
    finish(ax, "motors, µs")


def _draw_test(part: SubFigure, measured: Measurement, sines: Sequence[Segment]) -> None:
    """Draw the sine with the largest error, or the spectrogram of the first other test."""
    (u, _), (y, _) = measured.settings.names
    if not sines:
        test = measured.used[0] if measured.used else None
        spectrogram(measured.record, u, test, ax=part.subplots())
        return
    test = sines[0]
    response = measured.response
    if response is not None and response.variance is not None:
        worst = response.omega[np.argmax(response.variance / np.abs(response.response) ** 2)]
        test = min(sines, key=lambda s: abs(s.omega - worst))
    axes = part.subplots(2, 1, sharex=True)
    demodulated(measured.record, test, (u, y), axes=axes)
    axes[0].set_title(
        f"the sine with the largest error, {test.omega:.4g} rad/s", fontsize=TITLE_SIZE
    )
    part.align_ylabels(axes)


def _responses(measured: Measurement) -> tuple[list[FrequencyResponse], list[str]]:
    """Return the response as it was measured, and corrected for the filters that the output has passed."""
    response = measured.response
    if response is None:
        return [], []
    filters = list(chain(measured.record.filters.get(response.output, ())))
    if not filters:
        return [response], []
    passed = np.prod(
        [frequency_response(filter_model(f), {}, response.omega).response for f in filters], axis=0
    )
    variance = None if response.variance is None else response.variance / np.abs(passed) ** 2
    corrected = replace(response, response=response.response / passed, variance=variance)
    return [response, corrected], [
        "as logged",
        f"without the {' and the '.join(map(str, filters))}",
    ]
