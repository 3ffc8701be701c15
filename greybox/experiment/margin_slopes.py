"""How the margins of a loop change with the parameters of its plant: exact derivatives."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from greybox.estimate.result import Fit
from greybox.experiment.controller import Controller
from greybox.experiment.drawn_loops import plant_of_loop
from greybox.experiment.loop_numbers import margin_numbers, refined
from greybox.experiment.margins import LEAST
from greybox.experiment.sampled_loop import SampledLoop, plant_slopes, sampled_loop
from greybox.files.arrays import Array, ComplexArray
from greybox.modeling.model import Model, require_known

STEP = 1e-4  # of ln(omega), for slopes and least values along frequency: exact to 1e-8
DECIBELS = 20 / math.log(10)  # dB of a relative change


def margin_slopes(
    plant: Fit | Model,
    controller: Controller | Sequence[Controller],
    values: Mapping[str, float] | None = None,
    *,
    broken_at: str = "",
    at: Mapping[str, float] | None = None,
    part: int = 0,
) -> dict[str, dict[str, float]]:
    """Return the derivatives of the margins of a broken loop by the parameters of the plant.

    A margin is a function of the parameters that is defined by a root: the frequency at which the
    gain is one, or is real. Its derivative follows from those of the loop at this frequency
    (implicit function theorem), which are exact. A parameter limits a margin by its derivative
    times its standard error; `margins` has intervals that hold for large errors, too. At a delay of
    whole samples, where the derivative by the delay jumps, it is that toward longer delays.

    Parameters
    ----------
    plant, controller, values, broken_at, at, part
        As in `margins`.

    Returns
    -------
    dict of dict of float
        By the name of the margin, in its unit over that of the parameter, and by parameter. A
        margin that does not exist is left out.

    Raises
    ------
    ValueError
        If the loop is unstable, or the controllers do not fit the model.
    TypeError
        For a plant that is neither a fit nor a model, and for values given with a fit.

    Examples
    --------
    >>> import greybox as gb
    >>> from greybox.models.ardupilot import RateController
    >>> from greybox.models.rate import DampedAngle
    >>> loop = RateController(signals={"q": "theta_dot"})
    >>> slopes = gb.experiment.margin_slopes(DampedAngle(), loop)
    >>> slopes["phase margin"]["T_delay"] < 0
    True
    """
    model, center, known = plant_of_loop(plant, values, at=at, part=part)
    row = np.array([*center.values()])
    loop = sampled_loop(model, row[None], controller, **known)
    signal = broken_at or loop.inputs[0]
    require_known([signal], loop.signals, "signal", "the loop")
    if not loop.is_stable[0]:
        raise ValueError("the loop is unstable: it has no margins, so change its gains first.")

    located = refined(
        loop,
        lambda loops, omega: margin_numbers(loops.broken_at(signal, omega), omega, loops.is_stable),
    )
    places = {}
    for name, quantity in located.items():
        value, omega = quantity.first
        # A loop that rejects no disturbance has a bandwidth of zero, wherever its gain crosses.
        if math.isfinite(value) and math.isfinite(omega) and value != 0:
            places[name] = _nearest(loop, signal, omega) if name in LEAST else omega

    inside = plant_slopes(model, row, loop, np.array([*places.values()]), **known)
    answer = {}
    for (name, omega), slopes in zip(places.items(), inside, strict=True):
        slope = _slope(name.rstrip(" 0123456789"), *_gain(loop, signal, omega, slopes), omega)
        answer[name] = dict(zip(center, slope.tolist(), strict=True))
    return answer


def _nearest(loop: SampledLoop, signal: str, omega: float) -> float:
    """Return where the gain of the broken loop is nearest to -1, next to `omega`."""
    # Near its minimum a curve is flat, so the place of the minimum is less exact than its value. A
    # parabola through three points gives both.
    steps = np.array([-STEP, 0.0, STEP])
    squares = np.abs(1 + loop.broken_at(signal, omega * np.exp(steps))[0]) ** 2
    below, middle, above = squares
    bend = below - 2 * middle + above
    return omega * math.exp(steps[2] * (below - above) / (2 * bend)) if bend > 0 else omega


def _gain(
    loop: SampledLoop, signal: str, omega: float, inside: ComplexArray
) -> tuple[complex, complex, ComplexArray]:
    """Return the gain of the broken loop, its slope along omega, and those by parameters (p,)."""
    near = omega * np.exp([-STEP, STEP])
    below, above = loop.broken_at(signal, near)[0]
    closed = complex(loop.gains(signal, [signal], omega)[0, 0, 0])
    # The plant's change adds to what is measured: dG = (sensor to signal) dP (signal to input).
    driven = loop.gains(signal, loop.inputs, omega)[0, 0]
    arriving = np.array([loop.gains(s, [signal], omega)[0, 0, 0] for s in loop.sensors])
    change = arriving @ (inside @ driven).T
    return 1 / closed - 1, (above - below) / (near[1] - near[0]), -change / closed**2


def _slope(name: str, gain: complex, along: complex, slopes: ComplexArray, omega: float) -> Array:
    """Return the derivatives (p,) of a margin at `omega` from those of the broken loop's gain."""
    distance, outward = abs(1 + gain), (1 + gain).conjugate() / abs(1 + gain)
    nearer = (outward * slopes).real
    if name in LEAST:  # at its least, the distance does not change along frequency
        return nearer if name == "modulus margin" else -DECIBELS * nearer / distance

    # The shift of the frequency at which the gain is real, has a magnitude of one, or is 3 dB from
    # -1.
    if name in ("gain margin", "gain reduction margin"):
        moved = -slopes.imag / along.imag
    elif name == "disturbance rejection bandwidth":
        moved = -nearer / (outward * along).real
    else:
        moved = -(slopes / gain).real / (along / gain).real
    size, turn = ((slopes + along * moved) / gain * part for part in (1, -1j))
    lag = (np.angle(gain) + math.pi) % (2 * math.pi)
    by_name = {
        "gain margin": -DECIBELS * size.real,
        "gain reduction margin": DECIBELS * size.real,
        "phase margin": np.degrees(turn.real) * (1 if lag < math.pi else -1),
        "delay margin": turn.real / omega - lag / omega**2 * moved,
    }
    return by_name.get(name, moved)
