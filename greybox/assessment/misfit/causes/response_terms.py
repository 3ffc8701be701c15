"""Whether a response lacks a zero, a delay, a pole, a mode or a step of its gain."""

import itertools
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from greybox.assessment.misfit.term import ResponseTerm, Wording
from greybox.data.files.arrays import Array, ComplexArray

ZERO = Wording(
    "one more zero",
    "response: * (p.T_zero * s + 1)",
    opposite="one more zero, in the right half-plane",
)
DELAY = Wording(
    "a delay of {size} s",
    "response: * gb.exp(-s * p.T_delay)",
    opposite="a lead of {size} s",
)
POLE = Wording(
    "one more pole near {level} rad/s",
    "response: / (p.T_pole * s + 1)",
    opposite="a lead near {level} rad/s, one more zero and one more pole",
    opposite_code="response: * (p.T_zero * s + 1) / (p.T_pole * s + 1)",
)
MODE = Wording(
    "a lightly damped mode near {level} rad/s",
    "response: * (1 + p.new * s**2 / (s**2 + 2 * p.zeta * p.omega * s + p.omega**2))",
)
STEP = Wording(
    "a gain that differs above {level} rad/s",
    "two responses, one below and one above",
)
# Delays, times the highest frequency.
DELAYS = (0.5, 1.0, 2.0)
POLES, MODES, STEPS = 9, 16, 32  # numbers of frequencies
# Dampings of modes. With the first alone, a notch with a damping of 0.3 is seen in half of the
# cases, and with both in nine of ten.
DAMPINGS = 0.05, 0.2


def zeros(omega: Array) -> Iterator[ResponseTerm]:
    """Yield what a zero changes, and, as a delay in the model absorbs its phase, of its size."""
    s = 1j * omega / max(omega)
    for values in (s, np.abs(1 + s) - 1):
        yield ResponseTerm(ZERO, values=values, is_smooth=True)


def delays(omega: Array) -> Iterator[ResponseTerm]:
    """Yield delays."""
    for T in (np.array(DELAYS) / max(omega)).tolist():
        yield from _refined(DELAY, partial(_delay, 1j * omega), (T,), is_smooth=True)


def poles(omega: Array) -> Iterator[ResponseTerm]:
    """Yield poles, from below the lowest frequency to above the highest one."""
    for pole in np.geomspace(min(omega) / 2, 2 * max(omega), POLES).tolist():
        yield from _refined(POLE, partial(_pole, 1j * omega), (pole,), is_smooth=True)


def modes(omega: Array) -> Iterator[ResponseTerm]:
    """Yield lightly damped modes."""
    frequencies = np.geomspace(min(omega), max(omega), MODES).tolist()
    for levels in itertools.product(frequencies, DAMPINGS):
        yield from _refined(MODE, partial(_mode, 1j * omega), levels, is_smooth=False)


def gain_steps(omega: Array) -> Iterator[ResponseTerm]:
    """Yield gains that differ above some frequency."""
    edges = np.sqrt(omega[1:] * omega[:-1])
    # With a step at a wrong point, errors would look correlated.
    for edge in edges[:: max(len(edges) // STEPS, 1)]:
        yield ResponseTerm(STEP, values=1.0 * (omega > edge), level=edge)


def _refined(
    wording: Wording, shapes: partial, levels: tuple[float, ...], *, is_smooth: bool
) -> Iterator[ResponseTerm]:
    """Yield the terms of the shapes at levels, which a fit can refine."""
    for shape in shapes(*levels):
        yield ResponseTerm(
            wording,
            level=levels[0],
            scale=levels[0],
            values=shape,
            shapes=shapes,
            levels=levels,
            is_smooth=is_smooth,
        )


def _delay(s: ComplexArray, T: float) -> Sequence[ComplexArray]:
    return [np.exp(-s * T) - 1]


def _pole(s: ComplexArray, pole: float) -> Sequence[ComplexArray]:
    return [1 / (1 + s / pole) - 1]


def _mode(s: ComplexArray, omega: float, damping: float) -> Sequence[ComplexArray]:
    denominator = s**2 + 2 * damping * omega * s + omega**2
    return [omega**2 / denominator, s * omega / denominator]
