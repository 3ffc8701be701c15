"""What the problems of the paper share: its tables.

The tables are those of "Frequency Domain Identification of the Quadcopter Attitude Dynamics": real
flights of a quadcopter with an S500 frame, 10-inch propellers and a Pixhawk 4 with ArduPilot. The
setpoint of one angle followed sines, one frequency after another, (3.14); each point of a table is
a ratio (3.15) of Fourier filters (3.16).
"""

from pathlib import Path

import numpy as np

import greybox as gb

FOLDER = Path(__file__).parent / "data"


def table(number, prefix, output, name):
    """Return one response of a table, e.g. ``table("3.1", "pitch_", "theta", "pitch hover")``."""
    file = FOLDER / f"table_{number.replace('.', '_')}.csv"
    response = gb.read_response(file, prefix, input="u", output=output, name=name)
    return response.with_independent_errors()  # of sines one after another


def coefficients(numerator, *factors):
    """Return the coefficients of (2.13) by name; factors have the highest power first."""
    denominator = np.ones(1)
    for factor in factors:
        denominator = np.convolve(denominator, factor)
    b, a = np.array(numerator)[::-1] / denominator[0], denominator[:0:-1] / denominator[0]
    named = {f"b{k}": float(value) for k, value in enumerate(b)} | {
        f"a{k}": float(value) for k, value in enumerate(a)
    }
    return {
        name: value for name, value in named.items() if value or name != "a0"
    }  # an integrator has no a0
