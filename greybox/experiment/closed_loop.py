"""The gains from a sine that is added to one signal of a loop to the other signals.

Begin with `loop_gains`.
"""

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from greybox.experiment.controller import Controller
from greybox.experiment.multisine import multisine
from greybox.experiment.virtual_flight import virtual_flight
from greybox.files.arrays import Array, ComplexArray
from greybox.modeling import Model


def loop_gains(
    model: Model,
    values: Mapping[str, float],
    omega: ArrayLike,
    signals: Collection[str],
    *,
    excitation: str,
    controller: Controller | Sequence[Controller] | None,
    amplitude: float,
    rate: float,
) -> tuple[Array, dict[str, ComplexArray]]:
    """Return frequencies (n,) next to `omega`, and the gains (n,) from the excitation to the signals.

    They are measured in a virtual flight with a small sum of sines, so they include the sampling of
    the controller.

    Raises
    ------
    ValueError
        If a signal is not in the loop, or the loop diverges.
    """
    frequencies = np.sort(np.atleast_1d(np.asarray(omega, dtype=float)))
    # Four periods of the lowest frequency make neighboring frequencies distinct lines.
    samples = round(4 * 2 * math.pi / frequencies[0] * rate)
    line = 2 * math.pi * rate / samples
    harmonics = np.unique(np.maximum(np.rint(frequencies / line).astype(int), 1))
    sines = multisine(
        harmonics[0] * line * 0.999,
        harmonics[-1] * line * 1.001,
        samples / rate,
        rate,
        amplitude=1e-3 * amplitude,  # the loop is linear there, and rounding is far below
        signals=[excitation],
        points=None if len(harmonics) < 2 else max(len(harmonics), 2),
        periods=3,  # two to settle
    )
    chosen = np.asarray(sines.settings["harmonics"][excitation])
    measured = {name: 0.0 for name in signals if name not in _known(model, controller, excitation)}
    flown = virtual_flight(model, values, sines, controller=controller, noise=measured)
    last = {
        name: np.fft.rfft(np.asarray(flown[name])[-samples:]) for name in {*signals, excitation}
    }
    return chosen * line, {name: last[name][chosen] / last[excitation][chosen] for name in signals}


def _known(
    model: Model, controller: Controller | Sequence[Controller] | None, excitation: str
) -> set[str]:
    """Return the signals that a virtual flight logs by default."""
    controllers = [controller] if isinstance(controller, Controller) else list(controller or ())
    return {
        *model.input_names,
        *model.output_names,
        excitation,
        *(name for c in controllers for name in c.outputs),
    }
