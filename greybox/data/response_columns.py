"""Which columns of somebody's table are a frequency response, and in which units."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.magnitude_phase import angular_frequency, complex_response
from greybox.files.arrays import Array
from greybox.files.heading import heading
from greybox.files.text_table import alternatives

EXTRAS = ("coherence", "variance", "dof")
COMMON = re.compile(
    r"(alpha|beta)_common(\d+)"
)  # of common errors, see `FrequencyResponse.columns`
RECTANGULAR, POLAR = ("alpha", "beta"), ("magnitude", "phase")
ROLES = ("frequency", *RECTANGULAR, *POLAR, *EXTRAS)
UNITS = {"frequency": "rad/s or Hz", "magnitude": "absolute or dB", "phase": "deg or rad"}


class Column(NamedTuple):
    """Where a column stands, and its unit."""

    place: int
    unit: str


def stated_columns(columns: Mapping[str, str], header: Sequence[str]) -> dict[str, Column]:
    """Return the column of every role, of ``{"frequency": "f:Hz", "magnitude": "mag:dB", "phase": "ph:deg"}``.

    Names are those in the header, with or without the unit that stands there in brackets; one that
    is given behind a colon goes before it.

    Raises
    ------
    ValueError
        For a role or column that is not there, a pair that is not complete, or a unit that nobody
        states; the sentence goes on from the name of the file.
    """
    for role in columns:
        if role not in ROLES:
            raise ValueError(
                f"has no {role!r}, which is not a column of a frequency response; name {alternatives(role, ROLES)}"
            )
    pairs = [pair for pair in (RECTANGULAR, POLAR) if set(pair) & set(columns)]
    if "frequency" not in columns or len(pairs) != 1 or not set(pairs[0]) <= set(columns):
        raise ValueError(
            f"is no frequency response by {', '.join(columns)} alone: name the columns of frequency, magnitude and "
            "phase, or of frequency, alpha and beta."
        )
    found = {}
    for role, text in columns.items():
        place, unit = find_column(text, header)
        if role in UNITS and not unit:
            example = f"{text}:{UNITS[role].split()[-1]}"
            raise ValueError(
                f"has the column {text!r} without a unit: say whether it is {UNITS[role]}, {example}."
            )
        found[role] = Column(place, unit)
    return found


def assembled(
    values: Mapping[str, Array], columns: Mapping[str, Column], **others: Any
) -> FrequencyResponse:
    """Return the response of these columns (n,) by role; `others` are names and the like.

    Raises
    ------
    ValueError
        For units that are not known, and whatever a `FrequencyResponse` refuses.
    """
    omega = angular_frequency(values["frequency"], columns["frequency"].unit)
    if "alpha" in values:
        response = values["alpha"] + 1j * values["beta"]
    else:
        units = columns["magnitude"].unit, columns["phase"].unit
        response = complex_response(values["magnitude"], values["phase"], *units)
    return FrequencyResponse(omega, response, **extras(values), **others)


def extras(values: Mapping[str, Array]) -> dict[str, Any]:
    """Return what columns (n,) by name say beside the response, as a `FrequencyResponse` takes it.

    Raises
    ------
    ValueError
        For half of a common error.
    """
    known = {name: values[name] for name in EXTRAS if name in values}
    numbers = sorted({int(match[2]) for name in values if (match := COMMON.fullmatch(name))})
    half = [
        f"{part}_common{j}"
        for j in numbers
        for part in RECTANGULAR
        if f"{part}_common{j}" not in values
    ]
    if half:
        raise ValueError(
            f"there is no column {half[0]!r}: give both parts of a common error, or none."
        )
    errors = [values[f"alpha_common{j}"] + 1j * values[f"beta_common{j}"] for j in numbers]
    return known | ({"common_errors": np.array(errors)} if errors else {})


def find_column(text: str, header: Sequence[str]) -> Column:
    """Return the one column that ``name`` or ``name:unit`` means, in a header whose cells may have units too.

    Raises
    ------
    ValueError
        If there is none, or there are two; the sentence goes on from the name of the file.
    """
    name, _, unit = text.rpartition(":")
    for wanted, given in ((text, ""), (name, unit)):
        for known in ([*header], [heading(cell).name for cell in header]):
            if known.count(wanted) > 1:
                raise ValueError(f"has two columns {wanted!r}: rename or remove one.")
            if wanted in known:
                place = known.index(wanted)
                return Column(place, given or heading(header[place]).unit)
    raise ValueError(f"has no column {name or text!r}; it has {alternatives(name or text, header)}")
