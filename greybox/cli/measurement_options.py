"""The options of a measurement from a log, which `response` and `identify` share."""

import argparse
import math
from dataclasses import fields
from typing import Any

from greybox.cli.options import UsageError
from greybox.data.files.arrays import Interval
from greybox.data.files.named_values import selected
from greybox.workflows.identification.measurement import Settings

# Which tests, which samples, which estimate.
MEASUREMENT_OPTIONS = """
--instrument SIGNAL...
    the injected signal, for the joint estimate in closed loop (default: the injected signal that
    the log names); one for each of several inputs
--conditioned [NAME=]SIGNAL...
    further inputs that move together with the input in a sweep or noise; their effect on the output
    is removed
--open-loop
    direct estimate, although the log shows a controller
--rate HZ
    common sampling rate (default: the rate of the slowest signal)
--band FREQUENCY...
    lowest and highest frequency to use, in rad/s or followed by Hz (default: the excited band)
--axis AXIS
    use only the tests of this axis
--tests 1,3-5
    use only these tests, numbered as `greybox inspect` does
--settle SECONDS
    settling time discarded at the beginning of each sine (default: 2)
--period SECONDS
    period of a multisine, whose lines are then evaluated exactly, without windows; with several
    inputs or outputs, the period of the multisines on all inputs, for the matrix of responses
--whole
    use the whole log if no test is found
--points N
    number of frequencies of a sweep's estimate (default: 40)
--announced
--fields
--columns
--gaps
--setpoint
"""


def stated_choices(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options for one input and one output, by the names of `Settings`."""
    if len(options.instrument) > 1:
        raise UsageError(
            f"--instrument {' '.join(options.instrument)} has more signals than there are inputs: "
            "give one for each input."
        )

    # Options and settings have the same names, so that a new setting needs only its option.
    names = {field.name for field in fields(Settings)}
    return selected(vars(options), names) | {
        "band": stated_band(options.band),
        "instrument": "".join(options.instrument),
    }


def stated_band(words: list[str]) -> Interval | None:
    """Return the band in rad/s from ``1 80``, ``0.2 12 Hz`` or ``0.2Hz 12Hz``."""
    if not words:
        return None
    # People write the unit with a space, without one, or after both numbers.
    text = " ".join(words)
    in_hz = text.lower().endswith("hz")
    plain = text.lower().replace("rad/s", " ").replace("hz", " ").split()
    try:
        low, high = map(float, plain)
    except ValueError:
        raise UsageError(
            f"--band {text} is not understood: write two frequencies, --band 1 80 or "
            "--band 0.2 12 Hz."
        ) from None

    # The library computes in rad/s.
    factor = math.tau if in_hz else 1
    return low * factor, high * factor
