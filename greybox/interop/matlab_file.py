"""Fits, records and responses as MATLAB files, which scipy.io writes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from greybox.data.frequency_response import COLUMNS, FrequencyResponse
from greybox.data.record import Record
from greybox.estimate.fitted_part import FittedRecord, FittedResponse
from greybox.estimate.result import Fit
from greybox.files.safe_files import replacing
from greybox.interop.source_names import identifiers

LONGEST_NAME = 63  # characters, of MATLAB's variables and fields


def write_mat(thing: Fit | Record | FrequencyResponse, path: str | Path) -> None:
    """Write a MATLAB file, version 5, for MATLAB, Octave and `scipy.io.loadmat`.

    Names of signals and parameters become valid ones, ``RATE.POut`` is ``RATE_POut``. An existing
    file is replaced.

    Parameters
    ----------
    thing : Fit, Record or FrequencyResponse
        A record gives the variables ``time`` and its signals, columns of n numbers, and a struct
        ``units``; `gb.read` reads it back. A response gives ``omega`` in rad/s, complex
        ``response`` and what else is known, as ``idfrd(response, omega, 0)`` takes it. A fit gives
        a struct ``fit`` with the fields of `Fit.to_dict`, NaN for what is not known, and the data
        of every part next to those of the model.
    path : str or Path
        Ending in .mat.

    Raises
    ------
    TypeError, ValueError
        For anything else, or another ending.
    OSError
        If the folder cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".mat":
        raise ValueError(f"{path} is to be a MATLAB file: end it in .mat.")
    if isinstance(thing, Fit):
        contents = {"fit": _fit(thing)}
    elif isinstance(thing, Record):
        contents = _record(thing)
    elif isinstance(thing, FrequencyResponse):
        contents = _response(thing)
    else:
        raise TypeError(
            f"{thing!r:.60} cannot be written for MATLAB: give a Fit, a Record or a "
            "FrequencyResponse."
        )

    from scipy.io import savemat  # noqa: PLC0415  (takes a quarter of a second to import)

    with replacing(path) as temporary, temporary.open("wb") as file:
        savemat(file, contents, long_field_names=True, oned_as="column", do_compression=True)


def _fit(fit: Fit) -> dict[str, Any]:
    parts = []
    for part in fit.parts:
        about = {"name": part.name, "model": part.label, "equation": part.equation}
        if isinstance(part, FittedResponse):
            parts.append({**about, "data": _response(part.data), "fitted": part.response})
        elif isinstance(part, FittedRecord):
            parts.append({**about, "data": _record(part.data), "fitted": _record(part.simulated)})
    return {**_fields(fit.to_dict()), "part": np.array([*parts, None], dtype=object)[:-1]}


def _record(record: Record) -> dict[str, Any]:
    # "time" and "units" first: a signal of that name gets a number, and not the variable itself.
    names = {
        name: plain[:LONGEST_NAME]
        for name, plain in identifiers(["time", "units", *record.signals]).items()
    }
    signals = {names[name]: values for name, values in record.signals.items()}
    units = {names[name]: record.units.get(name, "") for name in record.signals}
    time = {"time": record.time} if record.has_time else {}
    return {**time, **signals, "units": units}


def _response(response: FrequencyResponse) -> dict[str, Any]:
    columns = {name: getattr(response, name) for name in (*COLUMNS, "common_errors")}
    texts = {name: getattr(response, name) for name in ("input", "output", "name", "source")}
    return {name: values for name, values in columns.items() if values is not None} | texts


def _fields(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return plain values as MATLAB has them, with names that it accepts."""
    # MATLAB refuses fields with dots or with more than 63 characters.
    names = identifiers(values)
    return {names[name][:LONGEST_NAME]: _value(value) for name, value in values.items()}


def _value(value: Any) -> Any:
    if value is None:
        return np.nan
    if isinstance(value, Mapping):
        return _fields(value)
    if isinstance(value, list):
        texts = [item for item in value if isinstance(item, str)]
        if texts or any(isinstance(item, Mapping) for item in value):
            # From items of one length numpy would make a matrix: an extra None keeps a list, a cell
            # array in MATLAB.
            return np.array([*map(_value, value), None], dtype=object)[:-1]
        return np.array(value, dtype=float)  # None is NaN

    return value
