"""The constant error of a measured signal, as a parameter of its own."""

import numpy as np

from greybox.data.record import Record
from greybox.modeling.parameter import Parameter

# Measured ranges of the signal that bound a bias: far beyond any error of a sensor.
WIDEST_BIAS = 10.0


def bias_name(signal: str) -> str:
    """Return the name of the constant error of a signal among the parameters."""
    return f"{signal}_bias"


def bias_parameter(name: str, record: Record) -> Parameter:
    """Return the unknown constant error of a signal, in a box around zero."""
    values = record[name][np.isfinite(record[name])]
    if not values.size:
        raise ValueError(
            f"biases names {name!r}, but the record has no measured value of it: leave it out."
        )

    span = float(np.ptp(values)) or 1.0  # a constant signal has no range
    return Parameter(
        0.0,
        bounds=(-WIDEST_BIAS * span, WIDEST_BIAS * span),
        # Near zero, since a larger error of a sensor would be seen by eye.
        starts=(-0.05 * span, 0.05 * span),
        unit=record.units.get(name, "1"),
        about=f"constant error of the measured {name}",
    )
