"""Filters of a flight controller with parameters from its log, from which models can be made.

`greybox.models.filters` has a model of the same name for each. They are written into the files of
responses as ``LowPass(20.0, 0.71)``, several in series as ``Notch(80.0, 1.9, 40.0) * LowPass(20.0,
0.71)``, and read from there as numbers for these three names alone.
"""

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

SERIES = " * "


@dataclass(frozen=True)
class KnownFilter:
    """A filter with known parameters, those of the model of its name."""

    @property
    def values(self) -> tuple[float, ...]:
        """The known parameters."""
        return tuple(float(value) for value in astuple(self) if value is not None)

    @property
    def model(self) -> str:
        """The model and its parameters, ``LowPass(20.0, 0.71)``."""
        return f"{type(self).__name__}({', '.join(map(repr, self.values))})"


KnownFilters = dict[str, tuple[KnownFilter, ...]]  # in series, by signal


@dataclass(frozen=True)
class LowPass(KnownFilter):
    """A second-order low-pass filter: cutoff, Hz; damping; if digital, its sampling rate, Hz."""

    cutoff: float
    damping: float = math.sqrt(0.5)
    rate: float | None = None

    def __str__(self) -> str:
        return f"{self.cutoff:g} Hz low-pass filter"


@dataclass(frozen=True)
class FirstOrderLowPass(KnownFilter):
    """A first-order low-pass filter: cutoff in Hz."""

    cutoff: float

    def __str__(self) -> str:
        return f"{self.cutoff:g} Hz first-order low-pass filter"


@dataclass(frozen=True)
class Notch(KnownFilter):
    """A notch filter: center, Hz; quality, center over bandwidth; attenuation at the center, dB."""

    center: float
    quality: float
    attenuation: float

    def __str__(self) -> str:
        return f"{self.center:.4g} Hz notch"


KINDS = {kind.__name__: kind for kind in (LowPass, FirstOrderLowPass, Notch)}


def in_series(filters: Sequence[KnownFilter]) -> str:
    """Return filters in series as text that `from_text` reads."""
    return SERIES.join(filter_.model for filter_ in filters)


def from_text(text: str) -> tuple[KnownFilter, ...]:
    """Return the filters that a text such as ``LowPass(20.0, 0.71)`` names.

    Raises
    ------
    ValueError
        For anything but known names with numbers.
    """
    filters = []
    for part in text.split(SERIES.strip()):
        # The text comes from a file: only known names and numbers, never an expression.
        name, _, numbers = part.strip().partition("(")
        try:
            values = list(map(float, numbers.removesuffix(")").split(",")))
            if not (numbers.endswith(")") and all(map(math.isfinite, values))):
                raise ValueError(part)
            filters.append(KINDS[name](*values))
        except (KeyError, ValueError, TypeError):
            raise ValueError(
                f"the filter {part.strip()!r:.60} is not known: it must be one of "
                f"{', '.join(KINDS)} with numbers."
            ) from None
    return tuple(filters)
