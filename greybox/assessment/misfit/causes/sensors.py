"""Whether a sensor is late or curved, or feels another output or an input at once."""

from collections.abc import Iterator

import numpy as np

from greybox.assessment.misfit.term import RecordTerm, Wording
from greybox.assessment.misfit.tested_record import Output, TestedRecord
from greybox.data.files.arrays import Array

LATE = Wording(
    "a sensor of {target} that is late by {size} s",
    "a state {target}_late as the output {target}, with the derivative (h - x.{target}_late) / "
    "p.T_late for the present output h; if the sensor is early, move {target} later in the record",
    opposite="a sensor of {target} that is early by {size} s",
)
CURVED = Wording(
    "a sensor of {target} with a curved characteristic",
    "a function of the output {target} in place of it, which gb.plotting.residuals draws",
)
CROSS = Wording(
    "an effect of {signal} on the sensor of {target}",
    "the output {target} gets + p.cross times the output {signal}",
)
DIRECT = Wording(
    "a direct effect of {signal} on {target}, one more zero",
    "the output {target} gets + p.direct * u.{signal}",
)


def sensors(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield faults of every sensor, and its couplings to other outputs and inputs."""
    for y in flight.outputs:
        for power in (2, 3):
            yield _at(y, CURVED, (y.values - np.mean(y.values)) ** power)
        if len(flight.outputs) > 1:
            yield from _lateness(flight, y)
        for other in flight.outputs:
            if other is not y:
                yield _at(y, CROSS, other.values, signal=other.name)
        yield from _direct_effects(flight, y)


def _at(
    y: Output, wording: Wording, values: Array, *, signal: str = "", scale: float = 1.0
) -> RecordTerm:
    return RecordTerm(wording, signal, y.name, values=values, effect=y.place, scale=scale)


def _lateness(flight: TestedRecord, y: Output) -> Iterator[RecordTerm]:
    for change, T in flight.shifts(y.values):
        # The error of a sample corrects the later outputs of a predictor.
        if T > 0 or not flight.record.is_predicted:
            yield _at(y, LATE, change, scale=abs(T))


def _direct_effects(flight: TestedRecord, y: Output) -> Iterator[RecordTerm]:
    for u in flight.all_inputs:
        # A controller responds at once: the noise of a sample is in the input at the same time.
        yield _at(y, DIRECT, flight.delayed(u.values, u.step), signal=u.name)
        if u.is_held and u.has_steps:
            yield _at(y, DIRECT, u.values, signal=u.name)
