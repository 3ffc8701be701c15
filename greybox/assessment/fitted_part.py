"""Each part of a fit as plain values: data, model, criterion and fitted values."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from greybox.assessment.stored_values import require
from greybox.data.files.arrays import AnyArray, Array, ComplexArray
from greybox.data.files.named_values import Values
from greybox.data.files.printed import one_line
from greybox.data.files.wording import counted
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import NOT_STORED, Record
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.modeling.formulation.frequency_criteria import MagnitudePhase, evaluate
from greybox.modeling.formulation.input_assumptions import Inputs, described_inputs
from greybox.modeling.formulation.prior import Prior
from greybox.modeling.formulation.signal_bias import bias_name
from greybox.statistics.metrics import fit_percent

PRIOR = Prior(noise={}).class_path


@dataclass(frozen=True, eq=False, kw_only=True)
class FittedPart(ABC):
    """One problem of the sum with its data, as plain values.

    Attributes
    ----------
    name, delay : str
    criterion : str
        Name of the criterion, such as ``relative-error``; `rule` is its formula in words.
    criterion_class, settings : str, mapping of name to value
        Class of the criterion, ``module:Class``, and its fields as plain values; both identify it.
    is_likelihood : bool
        Whether the cost is a negative log-likelihood.
    rule : str
    condition : str
        Assumption about the errors of the data on which the standard errors rest.
    weight : float
    rename : mapping of name to name
        Names in the estimate by names in the model.
    tied, constraints : mapping of name to str, tuple of str
        Source texts.
    model : mapping
        The model's reference (module, class, arguments), see `greybox.modeling.model_reference`.
    label, equation : str
        Name and docstring of the model.
    at, outputs
        Operating point and compared outputs by name; empty for kinds of data that do not have them.
    """

    name: str
    criterion: str
    criterion_class: str
    settings: Mapping[str, Any]
    is_likelihood: bool
    rule: str
    condition: str
    delay: str
    data: Any  # FrequencyResponse, Record or TransientSpectrum
    weight: float
    rename: Mapping[str, str]
    tied: Mapping[str, str]
    constraints: tuple[str, ...]
    model: Mapping[str, Any]
    label: str
    equation: str
    nuisances: int = 0
    at: Values = field(default_factory=dict, metadata=NOT_STORED)
    outputs: tuple[str, ...] = field(default=(), metadata=NOT_STORED)
    # Words for an element of the data, in singular and plural, and for the kind of the data.
    nouns: ClassVar[Any]

    def __repr__(self) -> str:
        return one_line(self, repr(self.name), self.label, self.criterion)

    @property
    def is_prior(self) -> bool:
        """Whether the part represents priors of parameters, not data."""
        return self.criterion_class == PRIOR

    def outside(self, name: str) -> str:
        """Return the name in the estimate of a parameter of the model."""
        return self.rename.get(name, name)

    @property
    def added(self) -> tuple[str, ...]:
        """Names of the parameters that the criterion added to those of the model."""
        return ()

    @property
    def sensor_noise(self) -> tuple[str, ...]:
        """Names of the `added` parameters that other criteria estimate too, as variances."""
        return ()

    @property
    def compared(self) -> int:
        """Number of points, lines or samples that are compared with the model."""
        return len(self.data)

    @property
    def residuals(self) -> AnyArray:
        """Measured less fitted values, (outputs, n); NaN where nothing was compared."""
        return np.array([self.residual(name) for name in self.outputs])

    @property
    def compared_numbers(self) -> int:
        """Number of real numbers in the data that are compared with the model."""
        return 2 * self.residuals.size

    @property
    @abstractmethod
    def signal_path(self) -> str:
        """Inputs and outputs, ``u → theta``."""

    @property
    def extent(self) -> str:
        """Band of the data, or the duration and rate of a record."""
        return f"{self.data.omega.min():.3g} to {self.data.omega.max():.3g} rad/s"

    def check(self) -> None:
        """Require that the values agree with one another, for a fit from an untrusted file.

        Raises
        ------
        ValueError
            The message names what does not agree.
        """
        kinds = {"class": str, "arguments": list, "keywords": dict}
        is_reference = all(isinstance(self.model[name], kind) for name, kind in kinds.items())
        require(is_reference, "its model is not a class with arguments")

    def residual(self, output: str) -> AnyArray:
        """Return measured less fitted values of one of several outputs, (n,)."""
        raise NotImplementedError

    @property
    def errors(self) -> Any:
        """Distribution of the errors in the criterion of a record; "normal" by default."""
        return self.settings.get("errors", "normal")

    def has_criterion_of(self, other: "FittedPart") -> bool:
        """Return whether both have the same criterion: one class with the same settings."""
        return (self.criterion_class, self.settings) == (other.criterion_class, other.settings)


def require_shapes(value: Any, axes_of: Mapping[str, str], sizes: Mapping[str, int]) -> None:
    """Require the shapes of the arrays of a value.

    Every axis of an array is a letter, whose length is in `sizes`, or "*" for any length.
    """
    for name, axes in axes_of.items():
        array = getattr(value, name)
        if array is None:
            continue

        is_right = array.ndim == len(axes)
        for axis, length in zip(axes, array.shape, strict=False):
            is_right = is_right and sizes.get(axis, length) == length
        require(is_right, f"{name} has another shape")


def _require_outputs(part: FittedPart, *signals: Mapping[str, Any]) -> None:
    """Require that the data and the fitted values have every output."""
    require(all({*part.outputs} <= {*names} for names in signals), "an output is not in the data")


class Curve:
    """Descriptor of the field `curve`, which evaluates a function of the part at the first use."""

    def __set__(self, part: Any, value: Any) -> None:
        vars(part)["curve"] = value

    def __get__(self, part: Any, owner: type) -> Any:
        # The dataclass reads the default from the class, with None for the part.
        value = part and vars(part)["curve"]
        if callable(value):
            value = vars(part)["curve"] = value(part)
        return value


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FittedResponse(FittedPart):
    """A frequency response with the fitted one.

    Attributes
    ----------
    response : (n,) complex array
        The fitted model at the data's frequencies; NaN when no start converged.
    curve : FrequencyResponse or None
        The fitted model on a fine grid over the band, for figures; None when no start converged.
        It may be given as a function of the part, which is evaluated when the curve is needed.
    at : mapping of name to float
    pade_error : float or None
        Largest phase error of the Padé approximation over the band, degrees; None with exact delay.
    nuisances : int
        Number of variances of the errors that were estimated too.
    """

    nouns = "point", "points", "frequency response"
    data: FrequencyResponse
    response: ComplexArray
    curve: FrequencyResponse | None = Curve()  # type: ignore[assignment]
    at: Values = field(default_factory=dict)
    pade_error: float | None

    @property
    def signals(self) -> dict[str, Any]:
        """Input, output, operating point and delay, as keywords for evaluating the model."""
        data = self.data
        return {"input": data.input, "output": data.output, "at": self.at, "delay": self.delay}

    @property
    def residuals(self) -> ComplexArray:
        """Measured less fitted response, (n,)."""
        return self.data.response - self.response

    @property
    def relative_residuals(self) -> Array:
        """Magnitudes of the residuals over those of the data, (n,); not finite at a zero."""
        with np.errstate(all="ignore"):
            return np.abs(self.residuals) / np.abs(self.data.response)

    @property
    def signal_path(self) -> str:
        """Input and output; the names of the model where the data have none."""
        named = self.curve or self.data
        return f"{named.input or 'input'} → {named.output or 'output'}"

    def check(self) -> None:
        """Require that the values agree with one another."""
        super().check()
        # Arrays of other shapes would be broadcast silently, and printed as if they belonged
        # together.
        count = len(self.data)
        require_shapes(self, {"response": "n"}, {"n": count})

    @property
    def magnitude_phase_cost(self) -> float:
        """The cost by `MagnitudePhase` whatever was fitted; NaN at a zero of the response.

        Guidelines: at most 200 for each pair, and 100 (good) to 150 (acceptable) on average over
        the pairs. Source: Tischler and Remple (2012), Aircraft and Rotorcraft System
        Identification, 2nd ed., chapter 11.
        """
        return evaluate(MagnitudePhase(), self.response, self.data)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FittedRecord(FittedPart):
    """A record with the fitted outputs.

    Attributes
    ----------
    data : Record
        The signals that the fit used.
    simulated : Record
        The fitted outputs at the same times; NaN where nothing was compared (gaps, the first
        samples before a delay has passed) or if no start converged.
    outputs : tuple of str
    noise : (k, k) array
        Covariance of the residuals of the outputs, given or estimated.
    initial : mapping of state to (stretches,) array
        The states at the first sample of every gapless stretch.
    method : str
        Transcription and integrator, with their automatic choices.
    inputs : "record", "linear" or "held"
        How the inputs varied between their samples: as `Record.hold` specifies for each input, or
        all inputs in the same way.
    biases : tuple of str
        Signals whose constant error was estimated, as the parameter ``<name>_bias``.
    gains : tuple of (state, output)
        Kalman gains, the parameters ``K_<state>_<output>``; empty for output error.
    driven : tuple of str
        States whose process noise ``w_<state>`` was estimated, with the noise ``v_<output>`` of the
        sensors; the gains follow from both.
    gain, gain_slope : (gains,) and (gains, m) arrays, or None
        Gains that follow from process noise, and their derivatives with respect to the parameters
        of the model and those `added`.
    nuisances : int
        Number of initial states, variances and covariances of the noise that were estimated too.
    is_static : bool
        Whether the outputs depend only on the inputs of the same moment.
    """

    data: Record
    simulated: Record
    outputs: tuple[str, ...] = ()
    noise: Array
    initial: Mapping[str, Array]
    method: str
    inputs: Inputs = "record"
    biases: tuple[str, ...] = ()
    gains: tuple[tuple[str, str], ...] = ()
    driven: tuple[str, ...] = ()
    gain: Array | None = None
    gain_slope: Array | None = None
    is_static: bool = False

    @property
    def compared(self) -> int:
        """Number of samples at which at least one output was compared."""
        return int(np.isfinite(self.residuals).any(axis=0).sum())

    @property
    def added(self) -> tuple[str, ...]:
        """Names of the parameters that the criterion added to those of the model."""
        # With process noise the gains follow from the variances, which are estimated instead.
        noise = [f"K_{state}_{output}" for state, output in self.gains]
        if self.driven:
            noise = [*(f"w_{state}" for state in self.driven), *self.sensor_noise]
        return (*map(bias_name, self.biases), *noise)

    @property
    def sensor_noise(self) -> tuple[str, ...]:
        """Names of the `added` parameters that are standard deviations of the outputs."""
        return tuple(f"v_{output}" for output in self.outputs) if self.driven else ()

    def innovation_parameters(self, output: str) -> int:
        """Return the number of noise parameters that were fitted to the residuals of an output."""
        return len(self.driven) or sum(of == output for _, of in self.gains)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs: the signals that are not outputs."""
        return tuple(name for name in self.data.signals if name not in self.outputs)

    @property
    def between(self) -> Mapping[str, str]:
        """How every input varied between its samples, in words; empty for a static model."""
        if self.is_static:
            return {}
        return described_inputs(self.inputs, self.input_names, self.data)

    @property
    def gaps(self) -> str:
        """Description of the gaps of the record; empty without a gap."""
        if self.is_static:
            return ""
        text = self.data.gaps_described(self.input_names)
        unused = self.unused
        return f"{text}; {counted(unused, 'sample')} not used" if unused and text else text

    @property
    def unused(self) -> int:
        """Number of samples with a measured output but without a compared one."""
        measured = np.any([np.isfinite(self.data[name]) for name in self.outputs], axis=0)
        return int(np.count_nonzero(measured)) - self.compared

    @property
    def compared_numbers(self) -> int:
        """Number of measured values that are compared with the model."""
        return int(np.isfinite(self.residuals).sum())

    @property
    def nouns(self) -> tuple[str, str, str]:  # type: ignore[override]
        """Samples or rows, and a record."""
        if self.data.has_time:
            return "sample", "samples", "record"
        return "row without a time", "rows without a time", "record"

    @property
    def signal_path(self) -> str:
        """Inputs and outputs."""
        return f"{', '.join(self.input_names) or 'no input'} → {', '.join(self.outputs)}"

    @property
    def extent(self) -> str:
        """Duration and rate of the data."""
        if not self.data.has_time:
            return "rows without a time"
        return f"{self.data.duration:.4g} s at {self.data.rate:.4g} Hz"

    def check(self) -> None:
        """Require that the values agree with one another."""
        super().check()
        sizes = {"o": len(self.outputs), "g": len(self.gains)}
        require_shapes(self, {"noise": "oo", "gain": "g", "gain_slope": "g*"}, sizes)
        is_same_time = np.array_equal(self.data.time, self.simulated.time)
        require(is_same_time, "the simulated record and its data have different times")
        is_list = all(states.ndim == 1 for states in self.initial.values())
        require(is_list, "an initial state is not a list")
        _require_outputs(self, self.data.signals, self.simulated.signals)

    def residual(self, output: str) -> Array:
        """Return measured less fitted values of an output, (n,)."""
        return self.data[output] - self.simulated[output]

    def fit_percent(self, output: str) -> float:
        """Return 100 (1 - |residual| / |measured - mean|), the fit of MATLAB's `compare`."""
        return fit_percent(self.data[output], self.simulated[output])


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FittedSpectrum(FittedPart):
    """The spectrum of a manoeuvre with the fitted outputs.

    Attributes
    ----------
    fitted : mapping of output to (n,) complex array
        Modelled outputs with their end terms; NaN if no start converged.
    outputs : tuple of str
    noise : (k, k) array
        Covariance of the errors of one sample in the band, given or estimated. For equation error,
        these are the errors of the equations, otherwise those of the outputs.
    ends : mapping of state to float
        First minus last value, which was estimated too.
    at : mapping of name to float
    nuisances : int
        Number of end values, variances and covariances of the noise that were estimated too.
    """

    nouns = "line", "lines", "manoeuvre"
    data: TransientSpectrum
    fitted: Mapping[str, ComplexArray]
    outputs: tuple[str, ...] = ()
    noise: Array
    ends: Values
    at: Values = field(default_factory=dict)

    @property
    def signal_path(self) -> str:
        """Inputs and outputs."""
        return f"{', '.join(self.data.inputs)} → {', '.join(self.outputs)}"

    def check(self) -> None:
        """Require that the values agree with one another."""
        super().check()
        require_shapes(self, {"noise": "oo"}, {"o": len(self.outputs)})
        is_complete = all(values.shape == (len(self.data),) for values in self.fitted.values())
        require(is_complete, "a fitted output is incomplete")
        _require_outputs(self, self.data.outputs, self.fitted)

    def residual(self, output: str) -> ComplexArray:
        """Return the measured less the fitted transform of an output, (n,)."""
        return self.data.outputs[output] - self.fitted[output]

    def fit_percent(self, output: str) -> float:
        """Return 100 (1 - |residual| / |measured|) over the band."""
        # Unlike in the time domain, no mean is subtracted: the band excludes zero frequency.
        size = np.linalg.norm(self.data.outputs[output])
        return float(100 * (1 - np.linalg.norm(self.residual(output)) / size)) if size else math.nan
