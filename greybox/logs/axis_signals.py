"""The signals of one axis of a vehicle, as a flight controller logs them."""

from greybox.files.arrays import Strings
from greybox.files.frozen_values import frozen


@frozen
class AxisSignals:
    """The signals of one axis, the best first; `terms` are terms of its controllers."""

    controls: Strings
    angles: Strings
    rates: Strings
    setpoints: Strings
    terms: Strings
    sticks: Strings = ()


# Names of angle and rate in models.
NAMES = {"roll": ("phi", "p"), "pitch": ("theta", "q"), "yaw": ("psi", "r")}
