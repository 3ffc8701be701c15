"""Finds the columns of a frequency response, and their units, in any table.

Magnitudes and phases in the units of instruments and other programs become complex responses.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from greybox.data.checked_array import require
from greybox.data.files.arrays import AnyArray, Array, ComplexArray, complex_array
from greybox.data.files.named_values import selected
from greybox.data.files.spelling import alternatives
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.headings import Column, find_column, headings
from greybox.data.units import known_unit

OMEGA = "omega_rad_s"
RECTANGULAR = ("alpha", "beta")
POLAR = ("magnitude", "phase")
EXTRAS = ("coherence", "variance", "dof")
COMMON = re.compile(r"(alpha|beta)_common(\d+)")  # see `FrequencyResponse.columns`
ROLES = ("frequency", *RECTANGULAR, *POLAR, *EXTRAS)
UNITS = {"frequency": "rad/s or Hz", "magnitude": "absolute or dB", "phase": "deg or rad"}
# In lower case, of a table with names of its own.
BODE = {"frequency": ("hz", "khz", "rad/s"), "magnitude": ("db",), "phase": ("deg", "°", "rad")}


def columns_by_role(columns: Mapping[str, str], header: Sequence[str]) -> dict[str, Column]:
    """Return the column of every role, from ``{"frequency": "f:Hz", "magnitude": "mag:dB", ...}``.

    Names are those in the header, with or without a unit in brackets. A unit behind a colon
    overrides the one in brackets.

    Raises
    ------
    ValueError
        For a role or column that does not exist, an incomplete pair, or a missing unit. The caller
        puts the name of the file before the message.
    """
    for role in columns:
        if role not in ROLES and not COMMON.fullmatch(role):
            raise ValueError(
                f"cannot have {role!r}, which is not a column of a frequency response; name "
                f"{alternatives(role, ROLES)}"
            )
    # One complete pair: magnitude with beta would not be a response.
    pairs = [pair for pair in (RECTANGULAR, POLAR) if set(pair) & set(columns)]
    if "frequency" not in columns or len(pairs) != 1 or not set(pairs[0]) <= set(columns):
        raise ValueError(
            f"needs more than the columns {', '.join(columns)} for a frequency response: name "
            "those of frequency, magnitude and phase, or of frequency, alpha and beta."
        )

    result = {}
    for role, text in columns.items():
        column = find_column(text, headings(header))
        if role in UNITS and not column.unit:
            unit = UNITS[role].split()[-1]
            raise ValueError(
                f"has the column {text!r} without a unit: state {UNITS[role]}, as in "
                f"'{text} [{unit}]' in the header or {text}:{unit} among the columns."
            )
        result[role] = column

    return result


def written_columns(header: Sequence[str], prefix: str) -> Mapping[str, str]:
    """Return the columns of a file from `write_response`, as `columns_by_role` takes them.

    Another table names them by their roles, as in ``frequency [Hz], magnitude [dB], phase [deg]``,
    or in other words with one column in dB: ``f [Hz], Gain [dB], ph [deg]``.

    Raises
    ------
    ValueError
        If a column is missing, or the prefix of one of several responses.
    """
    columns = headings(header)
    names = [column.name for column in columns]
    roles = {name.lower(): name for name in names if name.lower() in ROLES}
    if OMEGA not in names:
        by_unit = {
            role: [str(column) for column in columns if column.unit.lower() in units]
            for role, units in BODE.items()
        }
        if all(len(cells) == 1 for cells in by_unit.values()):
            return {role: cell for role, (cell,) in by_unit.items()} | roles
        if "frequency" in roles:
            return roles
    pairs = [name.removesuffix("_alpha") for name in names if name.endswith("_alpha")]
    required = {"frequency": OMEGA, **{role: prefix + role for role in RECTANGULAR}}
    missing = [name for name in required.values() if name not in names]
    if missing and pairs and not prefix:
        raise ValueError(
            f"has several responses, {', '.join(pairs)}: choose one by the names of its input and "
            "output."
        )

    for name in missing:
        if sum(column.base == name for column in columns) > 1:
            find_column(name, columns)  # names them all
    if missing:
        raise ValueError(
            f"has no column {missing[0]!r}; it has {', '.join(names)}: call the columns "
            "omega_rad_s, alpha, beta (real and imaginary part; p_lat_alpha, p_lat_beta and so on "
            "for several responses) and, if known, coherence, variance, dof, or, with units in "
            "brackets, frequency, magnitude, phase; or say which they are, columns={'frequency': "
            "...}, and so on."
        )
    # Files may have more columns, for other programs.
    others = [name.removeprefix(prefix) for name in names if name.startswith(prefix)]
    optional = [role for role in others if role in EXTRAS or COMMON.fullmatch(role)]

    return required | {"frequency": f"{OMEGA}:rad/s"} | {role: prefix + role for role in optional}


def assembled(
    values: Mapping[str, Array], columns: Mapping[str, Column], **others: Any
) -> FrequencyResponse:
    """Return the response of these columns (n,) by role; `others` are names and the like.

    A first point at 0 Hz is left out, as `about` then says.

    Raises
    ------
    ValueError
        For units that are not known, and whatever a `FrequencyResponse` refuses.
    """
    # Spectra of other programs begin with the mean, at 0 Hz, which is no response to a test.
    is_mean = values["frequency"] == 0
    if np.count_nonzero(is_mean) == 1 and is_mean[0] and is_mean.size > 1:
        values = {role: x[1:] for role, x in values.items()}
        others["about"] = {**others.get("about", {}), "left out": "the point at 0 Hz"}
    omega = angular_frequency(values["frequency"], columns["frequency"].unit)
    if "alpha" in values:
        response = complex_array(values["alpha"], values["beta"])
    else:
        units = columns["magnitude"].unit, columns["phase"].unit
        response = complex_response(values["magnitude"], values["phase"], *units)
    share = known_unit(columns["coherence"].unit) if "coherence" in columns else None
    if share:
        values = {**values, "coherence": share.apply(values["coherence"])}
    return FrequencyResponse(omega, response, **extras(values), **others)


def extras(values: Mapping[str, Array]) -> dict[str, Any]:
    """Return coherence, variance, dof and common errors if they are among the columns, (n,).

    Raises
    ------
    ValueError
        If one part of a common error is missing.
    """
    optional = selected(values, EXTRAS)
    # In the order of their numbers, whatever the order of the columns.
    numbers = sorted({int(match[2]) for name in values if (match := COMMON.fullmatch(name))})
    errors = []
    for j in numbers:
        alpha, beta = (f"{part}_common{j}" for part in RECTANGULAR)
        if alpha not in values or beta not in values:
            missing = beta if alpha in values else alpha
            raise ValueError(
                f"there is no column {missing!r}: give both parts of a common error, or none."
            )
        errors.append(complex_array(values[alpha], values[beta]))

    return optional | ({"common_errors": np.array(errors)} if errors else {})


def angular_frequency(frequency: Array, unit: str) -> Array:
    """Return frequencies (n,) in `unit`, of rad/s or Hz, in rad/s.

    Raises
    ------
    ValueError
        For another unit.
    """
    conversion = known_unit(unit)
    # In tables of responses Hz is a frequency in cycles; `to_si` keeps it as a unit of its own.
    if conversion and conversion.si == "Hz":
        return math.tau * conversion.factor * frequency
    if conversion and conversion.si == "rad/s":
        return conversion.apply(frequency)
    raise ValueError(f"the unit of frequency is {unit!r:.40}: give 'rad/s' or 'Hz'.")


def complex_response(
    magnitude: AnyArray, phase: Array, magnitude_unit: str, phase_unit: str
) -> ComplexArray:
    """Return the response (n,) of magnitudes, absolute or in dB (20 log10), and phases.

    Raises
    ------
    ValueError
        For other units, or a negative absolute magnitude.
    """
    conversion = known_unit(phase_unit)
    if conversion is None or conversion.si != "rad":
        raise ValueError(f"the unit of phase is {phase_unit!r:.40}: give 'deg' or 'rad'.")

    if magnitude_unit.lower() == "db":
        # A magnitude that overflows is refused later, as a response that is too large.
        with np.errstate(over="ignore"):
            magnitude = np.minimum(10 ** (magnitude / 20), np.finfo(float).max)
    elif magnitude_unit not in ("", "1", "abs", "absolute"):
        raise ValueError(
            f"the unit of magnitude is {magnitude_unit!r:.40}: give 'absolute' or 'dB'."
        )
    # Decibels without their unit are the usual mistake, and decibels are usually negative.
    cure = "if these are decibels, state dB as the unit of the column"
    require("magnitude", magnitude, magnitude >= 0, cure)

    return magnitude * np.exp(1j * conversion.apply(phase))
