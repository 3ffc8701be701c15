"""Whether an input acts through a lag, one more pole."""

from collections.abc import Iterator

import numpy as np

from greybox.assessment.misfit.term import RecordTerm, Wording
from greybox.assessment.misfit.tested_record import TestedRecord

LAG = Wording(
    "a lag of {signal} by {size} s, one more pole",
    "a state {signal}_lag with the derivative (u.{signal} - x.{signal}_lag) / p.T_lag, in place of "
    "u.{signal}",
    opposite="a lead of {signal} by {size} s, one more zero",
    opposite_code="a state {signal}_lag with the derivative (u.{signal} - x.{signal}_lag) / "
    "p.T_lag, and u.{signal} + p.new * (u.{signal} - x.{signal}_lag) in place of u.{signal}",
)
SHORTEST = 9.0  # inverse: a lag of a ninth of a step changes a sample by a rounding error only


def lags(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield lags of every input; with a negative factor they are leads."""
    for u in flight.inputs:
        for T in flight.time_constants(u.values).tolist():
            if u.step < SHORTEST * T:
                decay = float(np.exp(-u.step / T))
                # What the lag changes: the input itself is subtracted.
                change = flight.filtered(u.values, [-decay, decay], [1, -decay])
                yield u.term(LAG, change, scale=T)
