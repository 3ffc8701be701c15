"""Whether a function of any shape is missing: of a state, an input or an output."""

from collections.abc import Iterator

from greybox.assessment.misfit.causes.sensors import CURVED
from greybox.assessment.misfit.term import KNOTS, RecordTerm, Wording
from greybox.assessment.misfit.tested_record import TestedRecord

FUNCTION = Wording(
    "a function of {signal} in the equation of {target}",
    "the derivative of {target} gets a function of x.{signal} unlike the terms tried: "
    "gb.plotting.residuals draws it",
)
CHARACTERISTIC = Wording(
    "an input {signal} with a curved characteristic",
    "a function of u.{signal} in place of it, which gb.plotting.residuals draws",
)
FINE = 41  # knots of a function of an input, which an actuator may quantize


def functions(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield functions of the inputs, of the outputs, and of the states in every equation."""
    for u in flight.inputs:
        yield RecordTerm(CHARACTERISTIC, u.name, values=u.values, effect=u.place, knots=FINE)

    for y in flight.outputs:
        yield RecordTerm(CURVED, target=y.name, values=y.values, effect=y.place, knots=KNOTS)

    if flight.has_equations:
        for equation in flight.equations:
            for name, values in flight.states.items():
                if name in equation.signals:
                    place = flight.at_state(equation.index)
                    yield RecordTerm(
                        FUNCTION, name, equation.state, values=values, effect=place, knots=KNOTS
                    )
