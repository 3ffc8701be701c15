"""The signals of one axis of a vehicle, as a flight controller logs them."""

from greybox.data.files.frozen_values import frozen


@frozen
class AxisSignals:
    """The signals of one axis, the best first; `terms` are terms of its controllers."""

    controls: tuple[str, ...]
    angles: tuple[str, ...]
    rates: tuple[str, ...]
    setpoints: tuple[str, ...]
    terms: tuple[str, ...]
    sticks: tuple[str, ...] = ()


# Names of angle and rate in models.
NAMES = {"roll": ("phi", "p"), "pitch": ("theta", "q"), "yaw": ("psi", "r")}
