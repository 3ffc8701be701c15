"""A sine test: which signal is sinusoidal, and its amplitude."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.files.arrays import Array, frozen
from greybox.files.text_table import counted, one_line, require_kind, require_whole

# Five times the number that a strong kink needs, see `Sine`.
MOST_HARMONICS = 50


@frozen
class Sine:
    """A sine test of finite amplitude: one signal is its mean plus ``amplitude * cos(omega t)``.

    Parameters
    ----------
    signal : str
        The sinusoidal signal: the input of the data, or a state or an output that a loop held to a
        sine, as the setpoint sines (3.14) do with the angle. All other signals then have harmonics.
    amplitude : float or (n,) array, in the unit of the signal
        Half of the peak-to-peak value; a number for all frequencies, or one for each.
    harmonics : int, optional
        Number of harmonics of the other signals. By default as many as change the response by more
        than 0.03 %, at most 50; in a fit, as many as matter at the start values, at most 9. A fit
        warns if more harmonics would change its estimate.

    Raises
    ------
    ValueError
        If the amplitude is not finite and above 0, or the number of harmonics is not from 1 to 50.
    """

    signal: str
    amplitude: float | Array
    harmonics: int | None = None

    def __post_init__(self) -> None:
        """Check the values and make them read-only."""
        require_kind("the signal of a sine", self.signal, str, "its name")
        amplitude = np.array(self.amplitude)
        is_number = amplitude.dtype.kind in "iuf" and amplitude.ndim < 2 and amplitude.size
        if not is_number or not np.all(np.isfinite(amplitude) & (amplitude > 0)):
            raise ValueError(
                f"the amplitude of {self.signal!r} is {self.amplitude!r:.60}: give a finite number "
                "above 0, or one for each frequency."
            )

        amplitude = amplitude.astype(float)
        amplitude.setflags(write=False)
        vars(self)["amplitude"] = amplitude if amplitude.ndim else float(amplitude)
        if self.harmonics is not None:
            require_whole("harmonics", self.harmonics, 1, MOST_HARMONICS)

    def __repr__(self) -> str:
        low, high = np.min(self.amplitude), np.max(self.amplitude)
        size = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
        number = "as many harmonics as matter"
        if self.harmonics is not None:
            number = counted(self.harmonics, "harmonic")
        return one_line(self, self.signal, f"amplitude {size}", number)

    def amplitudes(self, omega: Array) -> Array:
        """Return the amplitude at every frequency, (n,).

        Raises
        ------
        ValueError
            If the lengths differ.
        """
        if np.ndim(self.amplitude) and np.size(self.amplitude) != omega.size:
            raise ValueError(
                f"the amplitude of {self.signal!r} has {np.size(self.amplitude)} values for "
                f"{omega.size} frequencies: give one for each, in the same order, or one number."
            )
        return np.broadcast_to(self.amplitude, omega.shape)

    def between(self, measured: Array, omega: Array) -> "Sine":
        """Return the sine at other frequencies, interpolated over the logarithm of `measured`."""
        if not np.ndim(self.amplitude):
            return self
        # Frequencies may be in any order, and `np.interp` needs increasing ones.
        order = np.argsort(measured)
        amplitudes = self.amplitudes(measured)[order]
        return replace(
            self, amplitude=np.interp(np.log(omega), np.log(measured[order]), amplitudes)
        )


def as_sine(given: Any) -> Sine:
    """Return a `Sine` from a `Sine` or ``{signal: amplitude}``.

    Raises
    ------
    TypeError, ValueError
        For anything else.
    """
    if isinstance(given, Sine):
        return given
    require_kind("amplitude", given, Mapping, "{signal: amplitude} or a Sine")
    if len(given) != 1:
        raise ValueError(
            f"amplitude names {', '.join(map(repr, given)) or 'nothing'}: give the one signal that "
            "is a sine."
        )

    return Sine(*next(iter(given.items())))
