"""How the inputs of a record are taken to run between their samples, and what is said of it.

The samples do not tell whether an input is held or interpolated, so the record says it
(`Record.hold`), or the user, or it is an assumption, which stands beside every result with its
size.
"""

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np

from greybox.data.intersample import CONTINUOUS, HELD, Intersample, intersample
from greybox.data.record import Record
from greybox.files.arrays import Array
from greybox.files.text_table import listed, number
from greybox.modeling.parameter import Parameter

Inputs = Literal["record", "linear", "held"]
"""How inputs run between their samples: as the record says, or all of them in one way."""

# Shift of a parameter, in standard errors, that does not matter: it adds 0.5 % to the root mean
# square error.
SMALL_SHIFT = 0.1

MOST_NAMED = (
    4  # parameters with their shifts, the largest in standard errors first: a sentence, not a table
)


def require_inputs(inputs: Any) -> None:
    """Raise ValueError for what is not one of `Inputs`."""
    if inputs not in get_args(Inputs):
        raise ValueError(
            f"inputs {inputs!r} is not known: use 'linear' or 'held', or 'record' to follow what the record says."
        )


def between_samples(
    inputs: Inputs,
    names: Sequence[str],
    record: Record,
    assumed: Mapping[str, float] = MappingProxyType({}),
) -> tuple[Intersample, ...]:
    """Return how each of the named inputs of a record is taken to run between its samples.

    Where neither `inputs` nor the record says it, `assumed` does (as `Record.hold`); otherwise it
    is interpolated. Rows without a time have nothing between them.
    """
    if not record.has_time:
        return tuple(Intersample(False) for _ in names)
    stated = {"linear": CONTINUOUS, "held": HELD}
    holds = [
        stated.get(inputs, record.hold.get(name, assumed.get(name, CONTINUOUS))) for name in names
    ]
    return tuple(intersample(hold, record.step) for hold in holds)


def described_inputs(inputs: Inputs, names: Sequence[str], record: Record) -> dict[str, str]:
    """Say how every input is taken to run between its samples, and who says so; nothing of rows without a time."""
    if not record.has_time:
        return {}
    result = {}
    for name, between in zip(names, between_samples(inputs, names, record), strict=True):
        who = "as the record says"
        if inputs != "record" or name not in record.hold:
            who = "an assumption" if inputs == "record" else "as stated"
            who += f", else delays differ by half a step, {number(500 * record.step, 3)} ms"
        result[name] = f"{between}, {who}"
    return result


def other_assumptions(
    inputs: Inputs, between: Mapping[str, Intersample], record: Record
) -> dict[str, Intersample]:
    """Return how moving inputs might run instead: as the record says, or, where nobody says it, held."""
    result = {}
    for name, now in between.items():
        if inputs != "record" and name not in record.hold:
            continue  # who states it knows it
        other = intersample(record.hold.get(name, HELD), record.step)
        values = record[name][np.isfinite(record[name])]
        if other != now and values.size and np.ptp(values) > 0:
            result[name] = other
    return result


def assumption_warning(
    asked: str,
    inputs: Inputs,
    between: Mapping[str, Intersample],
    others: Mapping[str, Intersample],
    effect: str,
) -> str:
    """Say what is assumed of the inputs `others`, the `effect` of the other assumption, and how to state which it is.

    `asked` is the criterion or the function whose argument `inputs` is.
    """
    names = list(others)
    are, it, they_are = ("is", "it", "it is") if len(names) == 1 else ("are", "them", "they are")
    now = between[names[0]]
    if inputs != "record":
        return (
            f"the record says that {listed(names)} {are} {others[names[0]]}, and {asked} takes {it} as {now}: what the "
            f"record says {effect}; leave out inputs={inputs!r} to follow it."
        )
    return (
        f"{listed(names)} {are} taken as {now} between samples; the record does not say, and the data cannot tell, "
        f"whether {they_are} held, as the output of a controller is, which {effect}: state it, "
        f"{asked}(..., inputs='held') or 'linear', or in the record, hold={{{names[0]!r}: math.inf}} or 0."
    )


def effect_of(
    parameters: Mapping[str, Parameter],
    shift: Array,
    errors: Array,
    delays: Collection[str],
) -> str:
    """Say by how much another assumption moves the estimates, (p,), in units and in standard errors.

    Empty where it does not matter: none is the value of one of the `delays`, and none moves
    noticeably.
    """
    relative = np.divide(np.abs(shift), errors, out=np.zeros(len(shift)), where=errors > 0)
    if not np.all(np.isfinite(shift)):
        return "moves the estimate by an unknown amount"
    names = list(parameters)
    order = np.argsort(-relative).tolist()
    moved = [k for k in order if names[k] in delays or relative[k] > SMALL_SHIFT]
    sizes = []
    for k in moved[:MOST_NAMED]:
        unit = parameters[names[k]].unit
        size = f"{names[k]} by {'+' if shift[k] > 0 else ''}{number(float(shift[k]), 2)}"
        size += f" {unit}" if unit not in ("", "1") else ""
        sizes.append(
            f"{size} ({number(float(relative[k]), 2)} standard errors)" if relative[k] else size
        )
    return f"moves {listed(sizes)}" if sizes else ""
