"""Each part of a fit as plain values: data, model, criterion and fitted values."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.files.arrays import (
    Array,
    ComplexArray,
    Named,
    NamedArrays,
    NamedStrings,
    Strings,
    Values,
)
from greybox.files.text_table import one_line
from greybox.formulation.frequency_criteria import MagnitudePhase, evaluate
from greybox.formulation.input_assumptions import Inputs, described_inputs
from greybox.formulation.prior import Prior
from greybox.modeling.sine import Sine
from greybox.statistics.metrics import fit_percent

PRIOR = Prior(noise={}).class_path


@dataclass(frozen=True, eq=False, kw_only=True)
class FittedPart:
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
        Errors of the data for which the standard errors hold.
    weight : float
    rename : mapping of name to name
        Names in the estimate by names in the model.
    tied, constraints : mapping of name to str, tuple of str
        Source texts.
    model : mapping
        The model's reference (module, class, arguments), see `greybox.modeling.model_reference`.
    label, equation : str
        Name and docstring of the model.
    """

    name: str
    criterion: str
    criterion_class: str
    settings: Named
    is_likelihood: bool
    rule: str
    condition: str
    delay: str
    data: FrequencyResponse | Record | TransientSpectrum
    weight: float
    rename: NamedStrings
    tied: NamedStrings
    constraints: Strings
    model: Named
    label: str
    equation: str
    nuisances: int = 0

    def __repr__(self) -> str:
        return one_line(self, repr(self.name), self.label, self.criterion)

    @property
    def is_prior(self) -> bool:
        """Whether the part represents priors of parameters, not data."""
        return self.criterion_class == PRIOR

    def outside(self, name: str) -> str:
        """Return the name in the estimate of a parameter of the model."""
        return self.rename.get(name, name)

    def has_criterion_of(self, other: "FittedPart") -> bool:
        """Return whether both have the same criterion: one class with the same settings."""
        return (self.criterion_class, self.settings) == (other.criterion_class, other.settings)


class Curve:
    """The field `curve`, whose value may be a function of the part until it is needed."""

    def __set__(self, part: Any, value: Any) -> None:
        vars(part)["curve"] = value

    def __get__(self, part: Any, owner: type) -> Any:
        # Without a part, a dataclass asks for the default.
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
        It may be given as a function of the part, which is evaluated when the curve is needed: for
        a sine, it takes an eighth of the time of a fit.
    at : mapping of name to float
    pade_error : float or None
        Largest phase error of the Padé approximation over the band, degrees; None with exact delay.
    sine : Sine or None
        The sine of finite amplitude that the model was given; None where it was linearized.
    nuisances : int
        Number of variances of the errors that were estimated too.
    """

    data: FrequencyResponse
    response: ComplexArray
    curve: FrequencyResponse | None = Curve()  # type: ignore[assignment]
    at: Values
    pade_error: float | None
    sine: Sine | None = None

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
    def compared_numbers(self) -> int:
        """Number of real numbers in the data that are compared with the model."""
        return 2 * len(self.data)

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
        How the inputs varied between their samples: as the record says (`Record.hold`), or all in
        one way.
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
    outputs: Strings
    noise: Array
    initial: NamedArrays
    method: str
    inputs: Inputs = "record"
    biases: Strings = ()
    gains: tuple[tuple[str, str], ...] = ()
    driven: Strings = ()
    gain: Array | None = None
    gain_slope: Array | None = None
    is_static: bool = False

    @property
    def compared(self) -> int:
        """Number of samples at which at least one output was compared."""
        return int(np.isfinite(self.residuals).any(axis=0).sum())

    @property
    def added(self) -> Strings:
        """Names of the parameters that the criterion added to those of the model."""
        # With process noise the gains follow from the variances, which are estimated instead.
        noise = [f"K_{state}_{output}" for state, output in self.gains]
        if self.driven:
            noise = [*(f"w_{state}" for state in self.driven), *(f"v_{y}" for y in self.outputs)]
        return (*(f"{name}_bias" for name in self.biases), *noise)

    def innovation_parameters(self, output: str) -> int:
        """Return the number of noise parameters that were fitted to the residuals of an output."""
        return len(self.driven) or sum(of == output for _, of in self.gains)

    @property
    def input_names(self) -> Strings:
        """Names of the inputs: the signals that are not outputs."""
        return tuple(name for name in self.data.signals if name not in self.outputs)

    @property
    def between(self) -> dict[str, str]:
        """How every input varied between its samples, in words; empty for a static model."""
        if self.is_static:
            return {}
        return described_inputs(self.inputs, self.input_names, self.data)

    @property
    def residuals(self) -> Array:
        """Measured less fitted values, (outputs, n); NaN where nothing was compared."""
        return np.array([self.residual(name) for name in self.outputs])

    @property
    def compared_numbers(self) -> int:
        """Number of measured values that are compared with the model."""
        return int(np.isfinite(self.residuals).sum())

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
        Covariance of the errors of one sample in the band, given or estimated: of the outputs, or,
        for equation error, of the equations.
    ends : mapping of state to float
        First minus last value, which was estimated too.
    at : mapping of name to float
    nuisances : int
        Number of end values, variances and covariances of the noise that were estimated too.
    """

    data: TransientSpectrum
    fitted: Mapping[str, ComplexArray]
    outputs: Strings
    noise: Array
    ends: Values
    at: Values

    @property
    def residuals(self) -> ComplexArray:
        """Measured less fitted transforms, (outputs, n)."""
        return np.array([self.residual(name) for name in self.outputs])

    @property
    def compared_numbers(self) -> int:
        """Number of real numbers in the data that are compared with the model."""
        return 2 * len(self.data) * len(self.outputs)

    def residual(self, output: str) -> ComplexArray:
        """Return the measured less the fitted transform of an output, (n,)."""
        return self.data.outputs[output] - self.fitted[output]

    def fit_percent(self, output: str) -> float:
        """Return 100 (1 - |residual| / |measured|) over the band."""
        # The mean is not subtracted, unlike in time: a band above zero frequency contains none.
        size = np.linalg.norm(self.data.outputs[output])
        return float(100 * (1 - np.linalg.norm(self.residual(output)) / size)) if size else math.nan


AnyFittedPart = FittedResponse | FittedRecord | FittedSpectrum
