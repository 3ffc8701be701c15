"""Refuses data that occur twice in a sum: as a record, and as an estimate from that record."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.data.frequency_response import FrequencyResponse, Stretch
from greybox.data.record import Record
from greybox.data.transient_spectrum import TransientSpectrum


def require_data_once(parts: Sequence[Any]) -> None:
    """Refuse a record beside a response or a spectrum that was estimated from a stretch of it.

    Their errors are the same, so that adding their likelihoods would count the information twice.

    Raises
    ------
    ValueError
        With the stretch.
    """
    records = [part for part in parts if isinstance(part.data, Record)]
    for part in parts:
        if isinstance(part.data, FrequencyResponse):
            noun, stretches = "response", tuple(part.data.stretches)
        elif isinstance(part.data, TransientSpectrum):
            noun, stretches = "spectrum", () if part.data.stretch is None else (part.data.stretch,)
        else:
            continue
        for stretch in stretches:
            used = next((record for record in records if _holds(record.data, stretch)), None)
            if used is not None:
                raise ValueError(
                    f"the {noun} {part.name!r} was estimated from {stretch.start:g} to "
                    f"{stretch.end:g} s of the record {used.name!r}, which would count the same "
                    "data twice: leave one of them out, or fit the record between other times, "
                    "record.between(start, end)."
                )


def _holds(record: Record, stretch: Stretch) -> bool:
    """Return whether a record has samples of a stretch."""
    # One common sample is not an overlap: stretches of a log may share their ends.
    first, last = np.searchsorted(record.time, [stretch.start, np.nextafter(stretch.end, np.inf)])
    return record.checksum == stretch.checksum and int(last - first) > 1
