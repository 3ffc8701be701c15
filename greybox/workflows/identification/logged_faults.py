"""What a logger did to the signals of a test, looked for in the log: resampling would smooth it."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from greybox.data.files.arrays import Interval
from greybox.data.record import Record, Recording
from greybox.data.signal_faults import SignalFault, record_faults
from greybox.data.spectral.experiment_quality import Finding


class Repaired(NamedTuple):
    """A recording without samples that are no measurements, and the faults of its signals.

    Attributes
    ----------
    recording : Recording
    removed : tuple of SignalFault
        Their samples were left out, and the others are right.
    remaining : tuple of SignalFault
        No sample is right.
    """

    recording: Recording
    removed: tuple[SignalFault, ...]
    remaining: tuple[SignalFault, ...]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was left out."""
        return tuple(
            Finding("samples", "note", math.nan, f"{f.seen}. These samples were left out.")
            for f in self.removed
        )


def repaired(
    recording: Recording, outputs: Mapping[str, str], inputs: Mapping[str, str], span: Interval
) -> Repaired:
    """Look for faults of signals in their own messages, and leave out the samples of a fault.

    Parameters
    ----------
    recording : Recording
    outputs, inputs : mapping of name in the test to "MESSAGE.Field"
    span : (start, end), s
    """
    removed: list[SignalFault] = []
    remaining: list[SignalFault] = []
    for name, signal in {**outputs, **inputs}.items():
        logged, field = recording.locate(signal)
        for fault in _faults(logged.between(*span), field, name, is_output=name in outputs):
            if not fault.rows.size:
                remaining.append(fault)
                continue
            removed.append(fault)
            values = logged[field].copy()
            values[np.flatnonzero(logged.during(*span))[fault.rows]] = np.nan
            rest = replace(logged, signals={**logged.signals, field: values})
            records = {key: rest if r is logged else r for key, r in recording.items()}
            recording = replace(recording, records=records)
    return Repaired(recording, tuple(removed), tuple(remaining))


def _faults(logged: Record, field: str, name: str, *, is_output: bool) -> tuple[SignalFault, ...]:
    """Return the faults of a field under its name in the test."""
    hold = {name: logged.hold[field]} if field in logged.hold else {}
    signals = {**logged.signals, name: logged[field]}
    renamed = replace(logged, signals=signals, hold={**logged.hold, **hold})
    return record_faults(renamed, (name,)) if is_output else record_faults(renamed, (), (name,))
