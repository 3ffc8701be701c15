"""Spectra of the vibration that gyros and accelerometers of a log show."""

import numpy as np

from greybox.data.record import Recording
from greybox.plotting.style import (
    TITLE_SIZE,
    AxesArray,
    GivenAxes,
    color_of,
    finish,
    label_horizontal,
    plain,
    stacked_axes,
)
from greybox.spectral.vibration import LOWEST, peaks_of, power_density, sensors

MOST = 8  # sensors in a figure; more would not fit a page


def vibration(
    recording: Recording, *, axes: GivenAxes | None = None, legend: bool = True
) -> AxesArray:
    """Draw the amplitude density of every fast gyro and accelerometer, a panel for each unit of each, with its peaks.

    Parameters
    ----------
    recording : Recording
        A log with raw batches (ISBH, ISBD of ArduPilot), or with IMU messages at 100 Hz or more.
    axes : array-like of Axes, optional
        One for each panel. Without it a new figure is made.
    legend : bool
        False leaves the legends inside the panels out.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
        The last line of a notebook cell is ``gb.plotting.vibration(log)[0].figure``.

    Raises
    ------
    ValueError
        If no sensor was logged fast enough, or for a wrong number of axes.
    """
    found = sensors(recording)
    panels = [
        (name, unit)
        for name, record in found.items()
        for unit in dict.fromkeys(map(record.units.get, record.signals))
    ][:MOST]
    if not panels:
        raise ValueError(
            f"{recording.source or 'the recording'} has no gyro or accelerometer at 100 Hz or more: log raw batches, "
            "INS_LOG_BAT_MASK 1, or the IMU fast, LOG_BITMASK."
        )
    drawn = stacked_axes(
        axes, [name for name, _ in panels], "this log", 9.0, 1.0 + 2.3 * len(panels)
    )
    spectra = {name: power_density(found[name]) for name in dict(panels)}
    fastest = max(hz[-1] for hz, _ in spectra.values())  # stacked axes share one range
    above = {"textcoords": "offset points", "xytext": (0, 3), "ha": "center"}
    for ax, (name, unit) in zip(drawn, panels, strict=True):
        record, (hz, densities) = found[name], spectra[name]
        rows = [
            (n, d)
            for n, d in zip(record.signals, densities, strict=True)
            if record.units.get(n) == unit
        ]
        for k, (signal, density) in enumerate(rows):
            ax.semilogy(
                hz[1:], np.sqrt(density[1:]), color=color_of(k), linewidth=1.0, label=plain(signal)
            )
            for peak in peaks_of(hz, density):
                height = np.sqrt(density[hz == peak][0])
                ax.annotate(f"{peak:.4g}", (peak, height), color=color_of(k), fontsize=8, **above)
        finish(ax, f"{plain(unit or '-')} / √Hz", legend)
        ax.set_title(plain(name), fontsize=TITLE_SIZE)
        ax.axvspan(0, LOWEST, color="0.5", alpha=0.15, lw=0)
        ax.set_xlim(0, fastest)
    label_horizontal(drawn, "Hz (shaded: motion of the vehicle; numbers: peaks)")
    return drawn
