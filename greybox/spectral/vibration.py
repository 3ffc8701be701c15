"""Vibration in records of raw IMU samples: its rms value and the frequencies of its peaks.

Vibration lies above the rates at which a flight controller logs attitudes, and aliases into them
unless it is filtered before.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.data.record import Record, Recording
from greybox.files.arrays import Array
from greybox.files.text_table import number, text_table

WINDOW = 1024  # samples, fewer if the batches are short or few: 1 Hz at 1 kHz
AVERAGES = 12  # fewest windows, half overlapping: the spectrum of noise then scatters by ±1.5 dB
LEAST = 64  # fewest samples of a stretch
PROMINENT = 10.0  # dB, height of a peak above its surroundings: more than six times that scatter
LOWEST = 10.0  # Hz; the motion of the vehicle lies below
LOWEST_RATE = 95.0  # Hz: resolves two octaves of vibration, less 5 % since clocks are not exact


@dataclass(frozen=True)
class Vibration:
    """One signal of a sensor: rate in Hz, rms above 10 Hz in its unit, peaks in Hz (highest first)."""

    message: str
    signal: str
    rate: float
    rms: float
    unit: str
    peaks: tuple[float, ...]


def sensors(recording: Recording) -> dict[str, Record]:
    """Return the gyros and accelerometers that were logged fast enough: raw batches and IMU messages."""
    fast = {}
    for name, record in recording.items():
        kind = name.partition("[")[0]
        names = [
            n
            for n in record.signals
            if kind == "ISBD" or (kind == "IMU" and n.startswith(("Gyr", "Acc")))
        ]
        if names and record.has_time and record.rate > LOWEST_RATE and _long_enough(record):
            fast[name] = replace(record, signals={n: record[n] for n in names}, checksum="")
    return fast


def power_density(record: Record) -> tuple[Array, Array]:
    """Return frequencies (n,), Hz, and the mean power density of every signal (signals, n)."""
    from scipy.signal import welch  # noqa: PLC0415  (takes a third of a second to import)

    pieces = _long_enough(record)
    count = min(
        WINDOW,
        2 * sum(len(piece) for piece in pieces) // AVERAGES,
        *(len(piece) for piece in pieces),
    )
    every = [np.array([*piece.signals.values()]) for piece in pieces]
    spectra = [welch(values, record.rate, nperseg=count, detrend="linear") for values in every]
    density = np.average(
        [power for _, power in spectra], axis=0, weights=[len(piece) for piece in pieces]
    )
    return spectra[0][0], density


def peaks_of(hz: Array, density: Array) -> tuple[float, ...]:
    """Return the frequencies of the three highest peaks of a power density (n,), Hz."""
    from scipy.signal import find_peaks  # noqa: PLC0415  (as above)

    level = 10 * np.log10(np.maximum(density, 1e-300))
    places, _ = find_peaks(level, prominence=PROMINENT)
    places = places[hz[places] >= LOWEST]
    return tuple(hz[places[np.argsort(-level[places])][:3]].tolist())


def vibration(message: str, record: Record) -> list[Vibration]:
    """Return the vibration in every signal of a record; none if its stretches are too short."""
    if not _long_enough(record):
        return []
    hz, densities = power_density(record)
    vibrations = []
    for name, density in zip(record.signals, densities, strict=True):
        rms = float(np.sqrt(np.sum(density[hz >= LOWEST]) * (hz[1] - hz[0])))
        vibrations.append(
            Vibration(
                message, name, record.rate, rms, record.units.get(name, ""), peaks_of(hz, density)
            )
        )
    return vibrations


def _long_enough(record: Record) -> list[Record]:
    return [piece for piece in record.pieces if len(piece) >= LEAST]


def vibration_table(vibrations: Sequence[Vibration]) -> str:
    """Return a table for a terminal."""
    rows = [
        (
            v.message,
            v.signal,
            number(v.rate, 4),
            f"{number(v.rms, 3)} {v.unit}",
            ", ".join(f"{p:.4g}" for p in v.peaks) or "-",
        )
        for v in vibrations
    ]
    return text_table(("vibration", "", "Hz", "rms", "peaks, Hz"), rows, left=(0, 1, 4))
