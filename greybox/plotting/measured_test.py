"""A measurement from a log as one figure: signals, spectrogram or sines, and the response.

Begin with `measurement`. `spectrogram` and `demodulated` draw one test of a record.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure as MatplotlibFigure
from matplotlib.figure import SubFigure

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record, Recording
from greybox.data.test_segment import Segment
from greybox.files.arrays import Array
from greybox.files.text_table import in_greek
from greybox.identification.identify import filter_model
from greybox.identification.measurement import Measurement
from greybox.logs.ardupilot.motors import limits, motor_outputs
from greybox.modeling.linear_response import frequency_response
from greybox.plotting.bode import bode_figure
from greybox.plotting.figure import INK, Figure, Panel, Series
from greybox.plotting.flight_log import signal_line
from greybox.plotting.matplotlib_figure import (
    AxesArray,
    GivenAxes,
    draw,
    draw_into,
    finish,
    height_of,
    label_horizontal,
    new_figure,
    plain,
)
from greybox.plotting.signals import ORANGE, shown_unit, signal_label, spans_of
from greybox.spectral.demodulation import least_squares, whole_periods
from greybox.spectral.saturation import at_limit

WIDTH, BODE_WIDTH = 8.2, 6.2  # inches


def measurement(measured: Measurement, recording: Recording | None = None) -> MatplotlibFigure:
    """Draw what was measured from a log.

    Input, output and instrument are drawn over time, with the tests shaded and samples at a limit
    marked; with the `recording` also the outputs of the motors, where it has them. Below them is
    the spectrogram of a sweep, or the demodulated sine over the raw signals for the test with the
    largest error. Beside them is the response, and, where the output has passed known filters, the
    response without them.

    Parameters
    ----------
    measured : Measurement
    recording : Recording, optional
        The log that it was measured from.

    Returns
    -------
    Figure
        pyplot does not know it: show it as the last line of a notebook cell, or save it with
        ``savefig``.
    """
    signals = _signals_figure(measured, recording)
    responses, labels = _responses(measured)
    bode = [bode_figure(responses, labels)] if responses else []
    sines = [test for test in measured.used if test.kind == "sine"]
    upper_height = height_of(signals, 1.25)
    lower_height = 4.0 if sines else 3.0
    height = max([upper_height + lower_height, *map(height_of, bode)])

    page = new_figure(WIDTH + BODE_WIDTH * len(bode), height)
    page.suptitle(plain(measured.record.name or "measurement"), fontsize=13)
    widths = (WIDTH, BODE_WIDTH)[: 1 + len(bode)]
    columns = page.subfigures(1, len(widths), width_ratios=widths, squeeze=False)[0]
    heights = (upper_height, lower_height)
    upper, lower = columns[0].subfigures(2, 1, height_ratios=heights, squeeze=False)[:, 0]
    draw_into(upper, signals, legend=False)
    _draw_test(lower, measured, sines)
    for column, figure in zip(columns[1:], bode, strict=True):
        response = replace(figure, subject="Measured response")
        draw_into(column, response, legend=len(responses) > 1)
    return page


def _signals_figure(measured: Measurement, recording: Recording | None) -> Figure:
    """Return the signals of a record and the outputs of the motors, with samples at a limit marked."""
    record = measured.record
    panels = []
    for k, name in enumerate(record.signals):
        values = record[name] * shown_unit(record.units.get(name, ""))[0]
        series = [signal_line("", record.time, values, k, width=0.8)]
        if k == 0:  # the input: actuators have limits
            series.append(_marked(record.time, values, at_limit(record[name])))
        panels.append(Panel(signal_label(record, name), series))

    motors = None
    if recording is not None:
        motors = motor_outputs(recording, float(record.time[0]), float(record.time[-1]))
    if motors is not None and recording is not None:
        low, high = limits(recording.metadata.get("parameters", {}))
        series = []
        for k, values in enumerate(motors.signals.values()):
            series.append(signal_line("", motors.time, values, k, width=0.8))
            series.append(_marked(motors.time, values, (values <= low) | (values >= high - 1)))
        panels.append(Panel("motors, µs", series))
    return Figure(
        "Signals",
        "Time, s (shaded: tests; marked: at a limit)",
        panels,
        spans=spans_of(measured.tests),
    )


def _marked(time: Array, values: Array, rows: np.ndarray) -> Series:
    return Series("at a limit", "points", time[rows], values[rows], ORANGE, style=1)


def spectrogram(
    record: Record, signal: str, segment: Segment | None = None, *, ax: Axes | None = None
) -> Axes:
    """Draw the power of a signal over time and frequency.

    Parameters
    ----------
    record : Record
        On a uniform time base, as `prepare` makes it. The longest of several pieces is drawn.
    signal : str
    segment : Segment, optional
        The test to draw; by default the whole record.
    ax : Axes, optional

    Returns
    -------
    Axes

    Raises
    ------
    KeyError, ValueError
        If the record does not contain the signal or the segment.
    """
    from scipy.signal import spectrogram as power  # noqa: PLC0415  (takes a third of a second to import)

    part = record if segment is None else record.between(segment.start, segment.end)
    part = max(part.pieces, key=len)
    values = part[signal] - part[signal].mean()
    # A logarithmic sweep over two decades passes a quarter of an octave in a twentieth of its
    # duration, and a window of this length has two periods of the lowest frequencies.
    count = int(np.clip(0.05 * len(part), 16, len(part)))
    if count > len(part) or len(part) < 32:
        raise ValueError(
            f"{len(part)} samples of {signal!r} are too few for a spectrogram: use a longer part."
        )
    overlap = count * 7 // 8
    hz, times, density = power(
        values, part.rate, "hann", count, overlap, nfft=4 * count, detrend="linear"
    )

    ax = new_figure(8.0, 3.0).subplots() if ax is None else ax
    omega = 2 * np.pi * hz[1:]
    density = np.maximum(density[1:], 1e-300)
    top = float(density.max())
    look = {"cmap": "viridis", "shading": "nearest", "rasterized": True}
    look["norm"] = LogNorm(top * 1e-6, top)  # 60 dB
    image = ax.pcolormesh(part.time[0] + times, omega, density, **look)
    low, high = omega[0], omega[-1]
    if segment is not None:
        low = max(segment.band[0] / 1.5, low)
        high = min(segment.band[1] * 2, high)
    ax.set_yscale("log")
    ax.set_ylim(low, high)
    finish(ax, "ω, rad/s")
    ax.figure.colorbar(image, ax=ax, label=plain(f"Power of {in_greek(signal)}"), pad=0.01)
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
    """Draw the last periods of a sine test: raw signals, and the sine, mean and trend fitted to each.

    Parameters
    ----------
    record : Record
        Angles are drawn in degrees.
    segment : Segment
        A sine.
    signals : sequence of str
    axes : array-like of Axes, optional
        One for each signal. By default a new figure is made.
    legend : bool
        Draw a legend.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)

    Raises
    ------
    KeyError, ValueError
        If the record has no such signal, or the test is not a sine or has no whole period.
    """
    figure = _demodulated_figure(record, segment, signals)
    return draw(figure, axes, legend=legend, width=8.0, inches=1.6)


def _demodulated_figure(record: Record, segment: Segment, signals: Sequence[str]) -> Figure:
    if segment.kind != "sine":
        raise ValueError(f"the test is a {segment.kind}: give a sine, or draw its spectrogram.")
    part = record.between(segment.start, segment.end)
    rows, _ = whole_periods(part.time, segment.omega, 0.0, None)
    time = part.time[rows]
    phase = segment.omega * (time - time[0])
    # In more than four periods, raw values and sine would lie on one another.
    shown = time >= time[-1] - 4 * 2 * math.pi / segment.omega
    panels = []
    for k, name in enumerate(signals):
        x = shown_unit(record.units.get(name, ""))[0] * part[name][rows]
        amplitude, drift, _ = least_squares(time, x[None], segment.omega, float(time[0]), 1)
        trend = x.mean() + drift[0] * (time - time.mean()) / (time[-1] - time[0])
        sine = trend + amplitude[0, 0].real * np.sin(phase) + amplitude[0, 0].imag * np.cos(phase)
        series = [
            Series("raw", "points", time[shown], x[shown], k),
            Series("demodulated", "line", time[shown], sine[shown], INK, width=1.2),
        ]
        panels.append(Panel(signal_label(record, name), series))
    subject = f"{segment.omega:.4g} rad/s"
    return Figure("Demodulated sine", "Time, s", panels, subject=subject)


def _draw_test(place: SubFigure, measured: Measurement, sines: Sequence[Segment]) -> None:
    """Draw the sine with the largest error, or the spectrogram of the first other test."""
    (u, _), (y, _) = measured.settings.names
    if not sines:
        test = measured.used[0] if measured.used else None
        spectrogram(measured.record, u, test, ax=place.subplots())
        return

    test = sines[0]
    response = measured.response
    if response is not None and response.variance is not None:
        relative = response.variance / np.abs(response.response) ** 2
        worst = response.omega[np.argmax(relative)]
        test = min(sines, key=lambda sine: abs(sine.omega - worst))
    figure = _demodulated_figure(measured.record, test, (u, y))
    draw_into(place, replace(figure, subject=f"Sine with the largest error, {figure.subject}"))


def _responses(measured: Measurement) -> tuple[list[FrequencyResponse], list[str]]:
    """Return the response as measured, and corrected for the filters that the output has passed."""
    response = measured.response
    if response is None:
        return [], []
    filters = list(chain(measured.record.filters.get(response.output, ())))
    if not filters:
        return [response], []
    passed = np.ones(len(response), dtype=complex)
    for known in filters:
        passed *= frequency_response(filter_model(known), {}, response.omega).response
    variance = None if response.variance is None else response.variance / np.abs(passed) ** 2
    corrected = replace(response, response=response.response / passed, variance=variance)
    return [response, corrected], [
        "as logged",
        f"without the {' and the '.join(map(str, filters))}",
    ]
