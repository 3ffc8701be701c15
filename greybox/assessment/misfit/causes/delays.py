"""Whether an input acts later or earlier than the model says."""

from collections.abc import Iterator
from dataclasses import replace

from greybox.assessment.misfit.term import RecordTerm, Wording
from greybox.assessment.misfit.tested_record import Input, TestedRecord

DELAY = Wording(
    "a delay of {signal} by {size} s",
    "delays = {{'{signal}': 'T_delay'}}, or * gb.exp(-s * p.T_delay); for a lead, {signal} moved "
    "earlier in the record, if its clock is late",
    opposite="a lead of {signal} by {size} s",
)
HOLD = Wording(
    "a delay of {signal} by {size} s, about half a step, as if it were held between samples",
    "hold={{'{signal}': math.inf}} in the record if it is held ('held' after the unit in the "
    "header of a table), or delays = {{'{signal}': 'T_delay'}}",
)
# A delay that is due to a hold is half a step, to first order: it is 3 to 9 % larger with square
# waves, steps and sweeps, and half as much again where a fitted lag of few steps has taken a part
# of the delay. Both cures are named.
NEAR = 0.6


def delays(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield delays and leads of every input."""
    for u in flight.inputs:
        for change, T in flight.shifts(u.values):
            yield replace(
                u.term(DELAY, change, scale=T),
                other_wording=lambda size, u=u: _other_wording(flight, u, size),
            )


def _other_wording(flight: TestedRecord, u: Input, size: float) -> Wording | None:
    """Return that the input has no gain, or is held, if nobody states how it runs."""
    is_unstated = flight.part.model.criterion.inputs == "record" and u.name not in flight.log.hold
    if is_unstated and abs(2 * size / u.step - 1) < NEAR:
        return HOLD
    return u.without_gain(size)
