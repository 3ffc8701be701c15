"""Files of gains that ground stations load."""

from collections.abc import Sequence
from pathlib import Path

from greybox.data.files.control_characters import printable
from greybox.data.files.named_values import Values
from greybox.data.files.public import public
from greybox.data.files.safe_files import write_text

REAL = 9  # MAV_PARAM_TYPE_REAL32 of MAVLink


@public
def write_gains(gains: Values, path: str | Path, comments: Sequence[str] = ()) -> None:
    """Write parameters to a file for a ground station, atomically.

    A name that ends in ``.params`` makes a file of QGroundControl for PX4 (columns vehicle,
    component, name, value, type); one that ends in ``.txt`` makes commands for the command line of
    Betaflight, in whole numbers, as this firmware stores them; any other name makes a file of
    ArduPilot, ``NAME,value``. Sources: QGroundControl, Parameter File Format; ArduPilot, Mission
    Planner Configuration and Tuning; Betaflight, Command Line Interface.

    In all three formats a line that begins with ``#`` is a comment.

    Parameters
    ----------
    gains : mapping of str to float
        The firmware's parameters, such as ``{"ATC_RAT_PIT_P": 0.14}``.
    path : str or Path
    comments : sequence of str
        Lines above the gains, such as their reason.

    Raises
    ------
    ValueError
        For a gain between 0 and 1 in a file for Betaflight, which would be rounded to another one.
    """
    path = Path(path)
    # A line of its own for every line: what follows a break would be read as a parameter.
    above = [f"# {printable(line)}" for text in comments for line in text.splitlines()]
    if path.suffix == ".params":
        header = ["# Vehicle-Id Component-Id Name Value Type"]
        lines = header + [f"1\t1\t{name}\t{value:.7g}\t{REAL}" for name, value in gains.items()]
    elif path.suffix == ".txt":
        small = {name: value for name, value in gains.items() if 0 < value < 1}
        if small:
            raise ValueError(
                f"gains of Betaflight are whole numbers, but {', '.join(small)} is below 1: end "
                f"{path} in .param or .params for another firmware."
            )
        lines = [*(f"set {name} = {value:.0f}" for name, value in gains.items()), "save"]
    else:
        lines = [f"{name},{value:.7g}" for name, value in gains.items()]
    write_text(path, "\n".join([*above, *lines]) + "\n")
