"""Spectra of the vibration that gyros and accelerometers of a log show."""

import numpy as np

from greybox.data.record import Recording
from greybox.files.arrays import Array
from greybox.plotting.figure import GRAY, Figure, Panel, Series
from greybox.plotting.matplotlib_figure import AxesArray, GivenAxes, draw
from greybox.spectral.vibration import LOWEST, peaks_of, power_density, sensors

MOST = 8  # panels: more would not fit a page


def vibration(
    recording: Recording, *, axes: GivenAxes | None = None, legend: bool = True
) -> AxesArray:
    """Draw the amplitude density of every fast gyro and accelerometer, with its peaks.

    There is a panel for each unit of each sensor, eight at most.

    Parameters
    ----------
    recording : Recording
        A log with raw batches (ISBH, ISBD of ArduPilot), or with IMU messages at 100 Hz or more.
    axes : array-like of Axes, optional
        One for each panel. By default a new figure is made.
    legend : bool
        Draw a legend.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
        In a notebook, ``gb.plotting.vibration(log)[0].figure`` shows the figure.

    Raises
    ------
    ValueError
        If no sensor was logged fast enough, or for a wrong number of axes.
    """
    panels = []
    fastest = 0.0
    for sensor, record in sensors(recording).items():
        hz, densities = power_density(record)
        fastest = max(fastest, float(hz[-1]))
        spectra = {
            name: _spectrum(name, k, hz, density)
            for k, (name, density) in enumerate(zip(record.signals, densities, strict=True))
        }
        for unit in dict.fromkeys(map(record.units.get, record.signals)):
            series = [spectra[name] for name in spectra if record.units.get(name) == unit]
            panels.append(Panel(f"{sensor}, {unit or '-'} / √Hz", series, is_logarithmic=True))
    if not panels:
        raise ValueError(
            f"{recording.source or 'the recording'} has no gyro or accelerometer at 100 Hz or "
            "more: log raw batches, INS_LOG_BAT_MASK 1, or the IMU fast, LOG_BITMASK."
        )

    figure = Figure(
        "Vibration",
        "Hz (shaded: motion of the vehicle; numbers: peaks)",
        panels[:MOST],
        subject=recording.source or "recording",
        spans=[(0.0, LOWEST, GRAY)],
        limits=(0.0, fastest),
    )
    return draw(figure, axes, legend=legend, width=9.0, inches=2.3)


def _spectrum(name: str, color: int, hz: Array, density: Array) -> Series:
    peaks = peaks_of(hz, density)
    labels = [f"{frequency:.4g}" if frequency in peaks else "" for frequency in hz[1:]]
    return Series(name, "line", hz[1:], np.sqrt(density[1:]), color, labels=labels, width=1.0)
