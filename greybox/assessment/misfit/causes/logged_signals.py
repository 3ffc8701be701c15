"""Whether a signal that is logged, but not in the model, acts, or orders a parameter."""

from collections.abc import Iterator

import numpy as np

from greybox.assessment.misfit.causes.nonlinear_terms import ADDED
from greybox.assessment.misfit.term import RecordTerm, Wording
from greybox.assessment.misfit.tested_record import TestedRecord
from greybox.data.files.arrays import Array
from greybox.statistics.column_space import beside

SCHEDULED = Wording(
    "{signal} grows with {target}, by {size} ± {error} per unit",
    "{target} as an input, and p.{signal} + p.{signal}_by_{target} * u.{target} in place of "
    "p.{signal}",
    opposite="{signal} falls with {target}, by {size} ± {error} per unit",
)
# Share of the variance of a signal that the motion explains, beyond which it is another sensor of
# it: this shows gusts, too, and would look like their cause.
SAME = 0.5


def logged_signals(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield the effects of logged signals, such as an airspeed or a second rudder."""
    for name, values in _unused_signals(flight):
        for equation in flight.equations:
            yield RecordTerm(
                ADDED,
                name,
                equation.state,
                values=values,
                effect=flight.at_state(equation.index),
                code=f"u.{name}, an input",
            )
        for parameter, place in flight.free_parameters:
            yield RecordTerm(SCHEDULED, parameter, name, values=values, effect=place)


def _unused_signals(flight: TestedRecord) -> Iterator[tuple[str, Array]]:
    record, system = flight.record, flight.part.system
    motion = np.vstack([record.states, record.inputs, flight.ones]).T
    for name in sorted(flight.log.signals.keys() - {*system.inputs, *system.outputs}):
        (signal,) = flight.part.data.at_samples(flight.log[name])
        # Noise of a sample may be that of the output: what the signal does, it does later.
        past = flight.delayed(signal, flight.step)
        if np.var(beside(past[:, None], motion)) > (1 - SAME) * np.var(past):
            yield name, past
