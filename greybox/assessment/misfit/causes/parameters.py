"""Whether a parameter has a wrong value: along the record, in one part, fixed, or at a bound."""

from collections.abc import Iterator

from greybox.assessment.misfit.term import RecordTerm, Wording
from greybox.assessment.misfit.tested_record import TestedRecord

CHANGES = Wording(
    "{signal} changes along the record",
    "two records, rename={{'{signal}': '{signal}_later'}} for the second",
)
FIXED = Wording(
    "a value of {signal} that is larger by {size} ± {error} than its fixed one",
    "free=['{signal}'] in the problem, no fixed value of it, and finite bounds in the model",
    opposite="a value of {signal} that is smaller by {size} ± {error} than its fixed one",
)
BOUND = Wording(
    "a value of {signal} that is larger by {size} ± {error} than its bound or constraint allows",
    "wider bounds or constraints of {signal}",
    opposite="a value of {signal} that is smaller by {size} ± {error} than its bound or constraint "
    "allows",
)
OWN = Wording(
    "a value of {signal} that is larger by {size} ± {error} in '{target}' than elsewhere",
    "rename={{'{signal}': '{signal}_own'}} in the problem '{target}'",
    opposite="a value of {signal} that is smaller by {size} ± {error} in '{target}' than elsewhere",
)


def changing_parameters(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield parameters that change along the record, gradually or at once."""
    for name, place in flight.free_parameters:
        for values in flight.along():
            yield RecordTerm(CHANGES, name, values=values, effect=place)


def own_values(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield values of parameters that differ from those of the other records."""
    for name, place in flight.free_parameters:
        part = flight.part.name
        yield RecordTerm(OWN, name, part, is_of_part=True, values=flight.ones, effect=place)


def bounded_parameters(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield values beyond the bounds that hold parameters: they are doubted more than all else."""
    for name, place in flight.held_parameters:
        yield RecordTerm(BOUND, name, is_doubted=True, values=flight.ones, effect=place)


def fixed_parameters(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield other values of fixed parameters."""
    for name, place in flight.fixed_parameters:
        yield RecordTerm(FIXED, name, has_shape=False, values=flight.ones, effect=place)
