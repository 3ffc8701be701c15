"""The measured frequency response of one input-output pair."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from greybox.data.checked_array import checked_array, finite_array, require, require_size
from greybox.data.checksum import checksum_of
from greybox.data.files.arrays import AnyArray, Array, BoolArray, ComplexArray, IntArray, all_finite
from greybox.data.files.control_characters import printable, write_out
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import attributes
from greybox.data.files.normalization import normalize
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.wording import counted
from greybox.data.intersample import HOLD, MULTIPLIED, NO_HOLD, response_of_hold
from greybox.data.pandas_frames import Frame, frame_of
from greybox.data.units import known_unit, to_si

COLUMNS = ("omega", "response", "coherence", "variance", "dof")

# Key and value of `FrequencyResponse.about`, and so a line of a file: the errors of different
# frequencies are independent by the design of the test.
ERRORS, INDEPENDENT = "errors along frequency", "independent"

# Key of `FrequencyResponse.about`: what a logger did to the samples, where this was not removed.
DAMAGE = "damage of the samples"


@public
@dataclass(frozen=True)
class Stretch:
    """A stretch of a record: checksum of the record, start and end in s on its clock."""

    checksum: str
    start: float
    end: float

    def __post_init__(self) -> None:
        """Check the times, and write out control characters."""
        if not (math.isfinite(self.start) and math.isfinite(self.end) and self.start <= self.end):
            raise ValueError(
                f"a stretch runs from {self.start:g} to {self.end:g} s: give finite times, the "
                "earlier one first."
            )
        checksum = printable(str(self.checksum))
        normalize(self, checksum=checksum, start=float(self.start), end=float(self.end))


@public
@frozen
class FrequencyResponse(Printed):
    """The complex response alpha + j beta of one input-output pair at the frequencies `omega`.

    Parameters
    ----------
    omega : (n,) array, rad/s
        Positive, each frequency once, in any order.
    response : (n,) complex array
        Output over input, in the output's unit per the input's unit.
    input, output : str
        Signal names, as in the model. Empty: the only pair of the model.
    coherence : (n,) array, optional
        Magnitude-squared coherence γ², above 0 and at most 1.
    variance : (n,) array, optional
        E|P̂ - P|²: the sum of the variances of the real and the imaginary part.
    dof : (n,) array, optional
        Degrees of freedom of each variance.
    name : str
        A label for tables and figures.
    source : str
        The file or the method that the numbers come from.
    stretches : tuple of Stretch
        The stretches of records from which the response was estimated, if they are known. They show
        whether a fit to a record and a response would use the same data twice.
    units : mapping of signal name to str
        The units of input and output, if known.
    about : mapping of str to str
        Description of the measurement, in words: excitation, instrument, points that were dropped,
        filters in the path, and so on. The checksum does not include it.
    common_errors : (m, n) complex array, optional
        Errors that are common to all points, such as that of a sensor's gain. Row j is the change
        of the response due to one standard deviation of the j-th error. `variance` includes these
        errors. The standard errors of a fit include them in full, since averaging over frequencies
        does not reduce them.

    Raises
    ------
    ValueError
        For empty data, different lengths, NaN or infinite values, values above 1e75 or below 1e-75
        (zero is allowed), non-positive or repeated frequencies.

    Examples
    --------
    >>> omega = np.array([1.0, 2.0, 4.0])  # rad/s
    >>> data = gb.FrequencyResponse(omega, 3 / (0.5j * omega + 1), input="u", output="p")
    >>> abs(data.response).round(3)
    array([2.683, 2.121, 1.342])
    >>> len(data.between(1.5, 5))
    2
    """

    omega: Array
    response: ComplexArray
    input: str = ""
    output: str = ""
    coherence: Array | None = None
    variance: Array | None = None
    dof: Array | None = None
    name: str = ""
    source: str = ""
    stretches: tuple[Stretch, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    about: Mapping[str, str] = field(default_factory=dict)
    common_errors: ComplexArray | None = None

    def __post_init__(self) -> None:
        """Convert to read-only arrays, check every value, and write out control characters."""
        write_out(self, "input", "output", "name", "source", "units", "about")
        self._check_columns()
        # The variance includes the common errors, so it must have been checked before them.
        errors = self._checked_errors()
        normalize(self, common_errors=errors, stretches=tuple(self.stretches))

    def _check_columns(self) -> None:
        for name in COLUMNS:
            if getattr(self, name) is None and name not in COLUMNS[:2]:
                continue
            kind = complex if name == "response" else float
            convert = finite_array if name in COLUMNS[:2] else checked_array
            values = convert(name, getattr(self, name), kind)
            normalize(self, **{name: values})
            require_size(name, values, "omega", self.omega.size)
            if name not in COLUMNS[:2]:
                high = 1.0 if name == "coherence" else np.finfo(float).max
                limit = "above 0 and at most 1" if name == "coherence" else "above 0"
                require(name, values, (values > 0) & (values <= high), f"it must be {limit}")

        if self.omega.size == 0:
            raise ValueError("the frequency response is empty: give at least one frequency.")
        cure = "frequencies must be finite and above 0 rad/s"
        require("omega", self.omega, self.omega > 0, cure)
        # Two points at one frequency would count as independent in a fit.
        values = np.sort(self.omega)
        repeated = values[1:][np.diff(values) == 0]
        if repeated.size:
            raise ValueError(
                f"omega = {repeated[0]:g} rad/s is repeated: average the points of one frequency, "
                "or add two problems, one for each experiment. For pairs, name columns p_lat_alpha."
            )

    def _checked_errors(self) -> ComplexArray | None:
        if self.common_errors is None:
            return None
        errors = np.atleast_2d(np.array(self.common_errors, dtype=np.complex128))
        if errors.ndim != 2 or errors.shape[1] != self.omega.size or not all_finite(errors):
            raise ValueError(
                f"common_errors has shape {np.shape(self.common_errors)}: give finite numbers, a "
                f"row of {self.omega.size} for each."
            )
        if self.variance is not None:
            # 1e-9 allows for the rounding of sums of squares that were written out in decimals.
            within = (np.abs(errors) ** 2).sum(axis=0) <= (1 + 1e-9) * self.variance
            if not within.all():
                raise ValueError(
                    "common_errors exceed the variance at omega = "
                    f"{self.omega[np.argmin(within)]:g} rad/s, but they are a part of it: add "
                    "their squares to it."
                )
        errors.setflags(write=False)

        return errors if len(errors) else None

    def __len__(self) -> int:
        return self.omega.size

    @property
    def pair(self) -> str:
        """Output and input, such as ``"p/lat"``; empty if one of them has no name."""
        return f"{self.output}/{self.input}" if self.output and self.input else ""

    @property
    def independent_share(self) -> Array:
        """Share of the variance that is independent from point to point, (n,)."""
        if self.common_errors is None or self.variance is None:
            return np.ones(len(self))
        # Rounding in a file may leave a share slightly below zero.
        return np.maximum(1 - (np.abs(self.common_errors) ** 2).sum(axis=0) / self.variance, 0.0)

    @property
    def has_independent_errors(self) -> bool:
        """Whether the errors of different frequencies were stated to be independent."""
        return self.about.get(ERRORS) == INDEPENDENT

    def with_independent_errors(self) -> "FrequencyResponse":
        """State that the errors of different frequencies are independent by the design of the test.

        They are independent if each frequency was measured in its own time, as with single sines
        that follow one another. Without this statement, a fit tests whether its residuals are
        correlated along frequency. A few points are too few for the test, so that the confidence
        intervals then allow for a correlation. With the statement, correlated residuals show that
        the model is incomplete. In a file, the comment ``# errors along frequency:
        independent`` states the same.
        """
        return replace(self, about={**self.about, ERRORS: INDEPENDENT})

    @property
    def relative_error(self) -> Array:
        """Standard error along and across the response over its magnitude, (n,).

        NaN if the variance is not known. It is the standard error of the phase in rad and of the
        logarithm of the magnitude if it is small.
        """
        if self.variance is None:
            return np.full(len(self), np.nan)
        # Half of the variance belongs to each of the two components.
        return np.sqrt(self.variance / 2) / np.maximum(np.abs(self.response), 1e-300)

    @property
    def alpha(self) -> Array:
        """Real part, (n,)."""
        return self.response.real

    @property
    def beta(self) -> Array:
        """Imaginary part, (n,)."""
        return self.response.imag

    @property
    def columns(self) -> Mapping[str, Array]:
        """The values at each frequency as real numbers, (n,) arrays by name, for tables and files.

        ``alpha, beta``, then, if known, ``coherence, variance, dof``, and ``alpha_common1,
        beta_common1`` and so on for the common errors.
        """
        columns = attributes(self, "alpha", "beta", "coherence", "variance", "dof")
        common = () if self.common_errors is None else self.common_errors
        for j, errors in enumerate(common, start=1):
            columns |= {f"alpha_common{j}": errors.real, f"beta_common{j}": errors.imag}
        return {name: values for name, values in columns.items() if values is not None}

    @property
    def checksum(self) -> str:
        """SHA-256 of the numbers and the signal names, whatever file they came from."""
        # Name, source and remarks are excluded: responses with the same numbers are the same data.
        columns = attributes(self, *COLUMNS).values()
        # The mark for a missing column distinguishes a variance from a coherence with the same
        # numbers.
        marked = ["-" if values is None else values for values in columns]
        common = [] if self.common_errors is None else [self.common_errors]
        return checksum_of(f"{self.input}->{self.output}", *marked, *common)

    def where(self, selected: BoolArray | IntArray) -> "FrequencyResponse":
        """Return the points at which a mask (n,) is true, or the points with these indices."""
        # Frequency is the last axis of every array.
        arrays = attributes(self, *COLUMNS, "common_errors").items()
        return replace(self, **{n: x[..., selected] for n, x in arrays if x is not None})

    @property
    def by_frequency(self) -> "FrequencyResponse":
        """The same points in the order of their frequencies."""
        return self.where(np.argsort(self.omega))

    def between(self, low: float, high: float) -> "FrequencyResponse":
        """Return the points from `low` to `high`, rad/s."""
        is_inside = (low <= self.omega) & (self.omega <= high)
        if not is_inside.any():
            raise ValueError(
                f"the response has no point from {low:.4g} to {high:.4g} rad/s; it runs from "
                f"{self.omega.min():.4g} to {self.omega.max():.4g} rad/s: give two frequencies in "
                "this range, the lower one first."
            )
        return self.where(is_inside)

    def times_s(self, output: str = "") -> "FrequencyResponse":
        """Multiply by jω, e.g. from an angle to its rate; `output` names the new signal."""
        return self.times(1j * self.omega, output, "/s")

    def over_s(self, output: str = "") -> "FrequencyResponse":
        """Divide by jω, e.g. from a rate to its angle; `output` names the new signal."""
        return self.times(1 / (1j * self.omega), output, "*s")

    def is_same_as(self, other: "FrequencyResponse") -> bool:
        """Return whether another response has the same data, or is a derivative of this one.

        The response of a rate is that of its angle times s. All criteria for responses without
        variances take errors relative to the response, which a factor does not change.
        """
        if self.checksum == other.checksum:
            return True
        has_variances = self.variance is not None or other.variance is not None
        if has_variances or not np.array_equal(self.omega, other.omega):
            return False
        factors = ((1j * self.omega) ** power for power in range(-2, 3))
        values = other.response
        return any(np.allclose(self.response * factor, values, rtol=1e-9) for factor in factors)

    def without_hold(self) -> "FrequencyResponse":
        """Return the response to the continuous input, as a fit compares it with a model.

        The estimates of `greybox.data.spectral` are responses to the samples of the input. If the
        input has a zero-order hold, which `about` then states, they include the response of the
        hold: about a delay of half the hold time. This method divides by it.
        """
        if HOLD not in self.about:
            return self
        hold = response_of_hold(self.omega, float(self.about[HOLD]))
        about = {NO_HOLD if name == HOLD else name: text for name, text in self.about.items()}
        return replace(self.times(1 / hold, self.output), about=about)

    @property
    def divided_hold(self) -> float:
        """The hold time, s, of the hold that `without_hold` divided out; zero if none was."""
        return float(self.about.get(NO_HOLD, 0.0))

    def times(
        self, factor: NDArray[np.complexfloating], output: str = "", unit: str = ""
    ) -> "FrequencyResponse":
        """Multiply by a factor (n,) of the unit `unit`; `output` names the new signal."""
        variance = None if self.variance is None else self.variance * np.abs(factor) ** 2
        common = None if self.common_errors is None else self.common_errors * factor
        # The unit of the output changes with the factor, so only that of the input is kept.
        name = output or self.output
        units = {key: value for key, value in self.units.items() if key == self.input}
        if conversion := known_unit(self.units.get(self.output, "")):
            units[name] = to_si(f"{conversion.si}{unit}").si

        return replace(
            self,
            response=self.response * factor,
            variance=variance,
            output=name,
            units=units,
            common_errors=common,
            about={**self.about, MULTIPLIED: name},
        )

    @property
    def decibels(self) -> Array:
        """Magnitude, (n,), dB; minus infinity where the response is zero."""
        return decibels_of(self.response)

    @property
    def degrees(self) -> Array:
        """Phase, (n,), degrees, without jumps; at the lowest frequency it is within ±180."""
        # The points may be in any order, and phase is continuous along frequency.
        order = np.argsort(self.omega)
        phase = np.empty(len(self))
        phase[order] = np.degrees(np.unwrap(np.angle(self.response[order])))
        return phase

    def to_pandas(self) -> Frame:
        """Return a pandas data frame with the angular frequency in rad/s as index.

        Its other columns are `columns`; ``frame.attrs`` has names, units and `about`.

        Raises
        ------
        ModuleNotFoundError
            Without pandas, ``pip install 'greybox-id[pandas]'``.
        """
        about = attributes(self, "input", "output", "name", "source", "units", "about")
        return frame_of(self.columns, self.omega, "omega_rad_s", about)

    def __str__(self) -> str:
        pair = f"{self.input or 'input'} -> {self.output or 'output'}"
        optional = attributes(self, "coherence", "variance", "dof", "common_errors")
        extras = [name.replace("_", " ") for name, values in optional.items() if values is not None]
        return (
            f"{self.name or 'frequency response'}: {pair}, "
            f"{counted(len(self), 'frequency', 'frequencies')} from {self.omega.min():g} to "
            f"{self.omega.max():g} rad/s"
            + (f", with {', '.join(extras)}" if extras else "")
            + (f"\nin doubt: {self.about[DAMAGE]}" if DAMAGE in self.about else "")
        )


def decibels_of(response: AnyArray) -> Array:
    """Return the magnitudes (n,) of a response, dB; minus infinity where it is zero."""
    with np.errstate(divide="ignore"):
        return 20 * np.log10(np.abs(response))
