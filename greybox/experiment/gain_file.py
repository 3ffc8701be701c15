"""Files of gains that ground stations load."""

from collections.abc import Mapping
from pathlib import Path

from greybox.files.safe_files import write_text

REAL = 9  # MAV_PARAM_TYPE_REAL32 of MAVLink


def write_gains(gains: Mapping[str, float], path: str | Path) -> None:
    """Write parameters to a file for a ground station, atomically.

    A name that ends in ``.params`` makes a file of QGroundControl for PX4 (columns vehicle,
    component, name, value, type); any other name one of ArduPilot, ``NAME,value``. Sources:
    QGroundControl, Parameter File Format; ArduPilot, Mission Planner Configuration and Tuning.

    Parameters
    ----------
    gains : mapping of str to float
        The firmware's parameters, such as ``{"ATC_RAT_PIT_P": 0.14}``.
    path : str or Path
    """
    path = Path(path)
    if path.suffix == ".params":
        header = ["# Vehicle-Id Component-Id Name Value Type"]
        lines = header + [f"1\t1\t{name}\t{value:.7g}\t{REAL}" for name, value in gains.items()]
    else:
        lines = [f"{name},{value:.7g}" for name, value in gains.items()]
    write_text(path, "\n".join(lines) + "\n")
