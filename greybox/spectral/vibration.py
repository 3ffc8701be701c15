"""Vibration in records of raw IMU samples: its size and the frequencies of its peaks.

What a flight controller's notches have to take away lies above the rates at which it logs
attitudes, and is folded into them where no filter stands before.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.data.record import Record, Recording
from greybox.files.arrays import Array
from greybox.files.text_table import number, text_table

WINDOW = 1024  # samples, or less where the batches are shorter or few: 1 Hz at 1 kHz
AVERAGES = 12  # windows, half overlapping, at least: the spectrum of noise then scatters by ±1.5 dB
LEAST = 64  # samples of a stretch that a spectrum is made of
PROMINENT = 10.0  # dB above its surroundings, of a peak: more than six times that scatter
MOST = 3  # peaks of a signal
LOWEST = 10.0  # Hz, below which the motion of the vehicle lies
FASTER = 10  # times that, the rate from which an octave and more of vibration is resolved
TOLERANCE = 0.05  # of a rate: clocks and time stamps are not exact


@dataclass(frozen=True)
class Vibration:
    """One signal of one sensor: sampling rate in Hz, rms above `LOWEST` in its unit, peaks in Hz, the highest first."""

    message: str
    signal: str
    rate: float
    rms: float
    unit: str
    peaks: tuple[float, ...]


def sensors(recording: Recording) -> dict[str, Record]:
    """Return gyros and accelerometers that were logged fast enough for vibration: raw batches, and the IMU messages."""
    found = {}
    for name, record in recording.items():
        kind = name.partition("[")[0]
        names = [
            n
            for n in record.signals
            if kind == "ISBD" or (kind == "IMU" and n.startswith(("Gyr", "Acc")))
        ]
        if (
            names
            and record.has_time
            and record.rate > (1 - TOLERANCE) * FASTER * LOWEST
            and _long_enough(record)
        ):
            found[name] = replace(record, signals={n: record[n] for n in names}, checksum="")
    return found


def power_density(record: Record) -> tuple[Array, Array]:
    """Return frequencies (n,), Hz, and the power density of every signal (signals, n), averaged over the stretches."""
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
    """Return the frequencies, Hz, of the peaks of a power density (n,), the highest first."""
    from scipy.signal import find_peaks  # noqa: PLC0415  (as above)

    level = 10 * np.log10(np.maximum(density, 1e-300))
    places, _ = find_peaks(level, prominence=PROMINENT)
    places = places[hz[places] >= LOWEST]
    return tuple(hz[places[np.argsort(-level[places])][:MOST]].tolist())


def vibration(message: str, record: Record) -> list[Vibration]:
    """Return the vibration in every signal of a record of fast samples; none if its stretches are too short."""
    if not _long_enough(record):
        return []
    hz, densities = power_density(record)
    found = []
    for name, density in zip(record.signals, densities, strict=True):
        rms = float(np.sqrt(np.sum(density[hz >= LOWEST]) * (hz[1] - hz[0])))
        found.append(
            Vibration(
                message, name, record.rate, rms, record.units.get(name, ""), peaks_of(hz, density)
            )
        )
    return found


def _long_enough(record: Record) -> list[Record]:
    return [piece for piece in record.pieces if len(piece) >= LEAST]


def vibration_table(found: Sequence[Vibration]) -> str:
    """Return a table for a terminal."""
    rows = [
        (
            v.message,
            v.signal,
            number(v.rate, 4),
            f"{number(v.rms, 3)} {v.unit}",
            ", ".join(f"{p:.4g}" for p in v.peaks) or "-",
        )
        for v in found
    ]
    return text_table(("vibration", "", "Hz", "rms", "peaks, Hz"), rows, left=(0, 1, 4))
