"""How the inputs of a record vary between their samples: held or interpolated.

The samples do not show which. The record states it (`Record.hold`), or the user does, or it is an
assumption, which every result reports with the size of its effect.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, get_args

from greybox.data.files.named_values import Values
from greybox.data.files.numbers_in_text import number
from greybox.data.intersample import CONTINUOUS, HELD, Intersample, intersample
from greybox.data.record import Record

Inputs = Literal["record", "linear", "held"]
"""How inputs vary between their samples: as the record says, or all of them in one way."""


def require_inputs(inputs: Any) -> None:
    """Raise ValueError for anything but one of `Inputs`."""
    if inputs not in get_args(Inputs):
        raise ValueError(
            f"inputs {inputs!r} is not known: use 'linear' or 'held', or 'record' to follow what "
            "the record says."
        )


def between_samples(
    inputs: Inputs,
    names: Sequence[str],
    record: Record,
    assumed: Values = MappingProxyType({}),
) -> tuple[Intersample, ...]:
    """Return how each of the named inputs of a record varies between its samples.

    If neither `inputs` nor the record states it, `assumed` does (like `Record.hold`); otherwise the
    input is interpolated. Data without a time have nothing between their rows.
    """
    if not record.has_time:
        return tuple(Intersample(False) for _ in names)
    for_all = {"linear": CONTINUOUS, "held": HELD}
    holds = [
        for_all.get(inputs, record.hold.get(name, assumed.get(name, CONTINUOUS))) for name in names
    ]
    return tuple(intersample(hold, record.step) for hold in holds)


def described_inputs(inputs: Inputs, names: Sequence[str], record: Record) -> Mapping[str, str]:
    """Return how every input varies between its samples, in words, and who states it."""
    if not record.has_time:
        return {}
    result = {}
    for name, between in zip(names, between_samples(inputs, names, record), strict=True):
        who = "as the record says"
        if inputs != "record" or name not in record.hold:
            who = "as assumed without a hold" if inputs == "record" else "as stated"
            who += f"; if wrong, delays change by half a step, {number(500 * record.step)} ms"
        result[name] = f"{between}, {who}"

    return result
