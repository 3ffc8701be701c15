"""Flexible modes of a steering mirror, from three piezo actuators to three displacement sensors.

Flown: not yet; on the ground, orthogonal multisines of random phase at 100, 200 and 300 mV moved
the mirror of the small satellite CubeSpec, sampled at 6400 Hz. The data are the best linear
approximation of the training part at each level: the matrix of every eighth excited line, from six
realizations. Its variance is the mean over eight lines, and contains what the hysteresis of the
piezos adds.

Source: Floren et al., Fine Steering Mirror benchmark, 2024,
https://github.com/merijnfloren/fsm-benchmark-data, CC BY 4.0, license in
`data/fine_steering_mirror_LICENSE.txt`. `benchmarks/boards/fine_steering_mirror.py --excerpt`
writes the tables.
"""

from pathlib import Path
from typing import Any

import numpy as np

import greybox as gb
from greybox.models.flexible_modes import FlexibleModes, Mode

minimum = (
    9625.9276  # every one of 100 starts; a negative log-likelihood, and the model is incomplete
)
settings: dict[str, Any] = {"starts": 100, "seed": 0}

LEVELS = (100, 200, 300)  # mV
BAND = 2 * np.pi * np.array([20.0, 1150.0])  # rad/s
FOLDER = Path(__file__).parent / "data"

# Peaks of the response at 300 mV. Shapes: linear least squares at these frequencies and a damping
# of 0.012, and the rank-one part of every mode, in µm/V.
MODES = (
    Mode(2 * np.pi * 636.0, (-0.16, -0.01, -0.42), (1.0, 0.85, -0.59)),
    Mode(2 * np.pi * 805.8, (-0.49, 1.5, -0.79), (1.0, -0.55, -0.58)),
    Mode(2 * np.pi * 921.6, (-1.74, -1.24, 2.07), (-0.06, -0.65, 1.0)),
    Mode(2 * np.pi * 990.0, (-0.72, -0.35, -0.9), (1.0, 0.78, 0.52)),
)
GAINS = ((-1.45, -0.31, -1.83), (0.12, -3.77, -2.39), (-1.12, -2.22, -0.88))


def data(level=300):
    """Return the nine responses at a level of 100, 200 or 300 mV, below 1150 Hz."""
    matrix = gb.data.read_responses(FOLDER / f"fine_steering_mirror_{level}mV.csv")
    return tuple(response.between(*BAND) for response in matrix)


def problem(level=300):
    """Return four modes behind one delay, with the gains of those above, at one level."""
    signals = ("u1", "u2", "u3"), ("y1", "y2", "y3")
    model = FlexibleModes(MODES, GAINS, *signals, delay=5e-4)
    stated = gb.several(model, data(level), criterion=gb.MaximumLikelihood())
    return stated.with_(name="modes of a steering mirror")
