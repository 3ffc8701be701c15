"""Tables of Betaflight's blackbox, as `blackbox_decode` and Blackbox Explorer write them.

The first column is loopIteration, the time is in µs. Explorer writes the settings of the vehicle
before the header.

Source: https://github.com/betaflight/blackbox-tools, src/blackbox_decode.c; the fields in
blackbox.c of the firmware.
"""

import re
from collections.abc import Sequence

from greybox.files.heading import Heading

HEADER = re.compile(rb'^"?loopIteration"?\s*,', re.MULTILINE)
TIME = "time"
# Of fields that are written without one.
UNITS = {
    r"gyro(ADC|Unfilt)\[\d\]": "deg/s",
    r"setpoint\[[0-2]\]": "deg/s",
}


def without_settings(raw: bytes) -> bytes:
    """Return a table whose lines before the header are comments; line numbers stay right."""
    header = HEADER.search(raw)
    if header is None or not header.start():
        return raw
    settings = raw[: header.start()].split(b"\n")
    return b"\n".join(b"#" + line for line in settings[:-1]) + b"\n" + raw[header.start() :]


def with_units(headings: Sequence[Heading]) -> list[Heading]:
    """Return the headings with the units that Betaflight does not write."""
    if not headings or headings[0].name != "loopIteration":
        return list(headings)
    return [h if h.unit else Heading(h.name, _unit(h.name)) for h in headings]


def _unit(name: str) -> str:
    return (
        "us"
        if name == TIME
        else next((unit for key, unit in UNITS.items() if re.fullmatch(key, name)), "")
    )
