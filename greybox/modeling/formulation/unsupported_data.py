"""What a problem cannot take as data, in words, with the cure."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from greybox.data.record import Recording


def described(data: Any) -> str:
    """Return what the data are and what to give instead, as the end of a sentence."""
    if isinstance(data, Recording):
        first = next(iter(data), "MESSAGE")
        return (
            f"a log with the messages {', '.join(data):.200}: give one of its records, such as "
            f"log[{first!r}], or what gb.prepare(log, {{name: 'MESSAGE.Field'}}) makes of several"
        )
    if isinstance(data, str | Path):
        path = str(data)
        return (
            f"the path {path!r}: read the file first, gb.read_response({path!r}) for a frequency "
            f"response or gb.read({path!r}) for records"
        )

    if isinstance(data, list | tuple) or (isinstance(data, np.ndarray) and data.dtype == object):
        return (
            f"a list with {len(data)} in it: use gb.several(model, [...]), or gb.Record for arrays"
        )
    if isinstance(data, Mapping):
        return (
            f"a mapping with the keys {', '.join(map(repr, data)):.200}: give every "
            "FrequencyResponse by its pair (output/input), gb.several(model, {'p/lat': response})"
        )

    if hasattr(data, "iloc"):
        return "a pandas data frame: give gb.Record.from_pandas(frame)"
    return (
        f"{data!r:.80}: give a FrequencyResponse, a Record or a TransientSpectrum; of objects "
        "of python-control, gb.interop.from_control(...) makes responses"
    )
