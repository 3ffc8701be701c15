"""Criteria for records: the mismatch between a model's simulated outputs and measured ones.

How the inputs of a record vary between their samples: held or interpolated.

The samples do not show which. The record states it (`Record.hold`), or the user does, or it is an
assumption, which every result reports with the size of its effect.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace
from types import MappingProxyType
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from greybox.data.files.argument_checks import as_names, is_finite_number
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values, attributes
from greybox.data.files.normalization import normalize
from greybox.data.files.numbers_in_text import number
from greybox.data.intersample import CONTINUOUS, HELD, Intersample, intersample
from greybox.data.record import Record, require_time
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.modeling.colored_disturbance import ColoredDisturbance, gust_on, undisturbed
from greybox.modeling.formulation.criterion import AnyCriterion
from greybox.modeling.formulation.error_covariance import (
    ErrorCovariance,
    EstimatedVariances,
    error_covariance,
    stated_noise,
)
from greybox.modeling.formulation.signal_bias import bias_name, bias_parameter
from greybox.modeling.model import Model, ParameterFormula, require_known
from greybox.modeling.parameter import Parameter
from greybox.statistics.error_distribution import ErrorDistribution, NormalErrors
from greybox.statistics.huber import HuberErrors

Inputs = Literal["record", "linear", "held"]
"""How inputs vary between their samples: as the record says, or all of them in one way."""


def require_inputs(inputs: Any) -> None:
    """Raise ValueError for anything but one of `Inputs`."""
    if inputs not in get_args(Inputs):
        raise ValueError(
            f"inputs {inputs!r} is not known: use 'linear' or 'held', or 'record' to follow what "
            "the record says."
        )


def between_samples(
    inputs: Inputs,
    names: Sequence[str],
    record: Record,
    assumed: Values = MappingProxyType({}),
) -> tuple[Intersample, ...]:
    """Return how each of the named inputs of a record varies between its samples.

    If neither `inputs` nor the record states it, `assumed` does (like `Record.hold`); otherwise the
    input is interpolated. Data without a time have nothing between their rows.
    """
    if not record.has_time:
        return tuple(Intersample(False) for _ in names)
    for_all = {"linear": CONTINUOUS, "held": HELD}
    holds = [
        for_all.get(inputs, record.hold.get(name, assumed.get(name, CONTINUOUS))) for name in names
    ]
    return tuple(intersample(hold, record.step) for hold in holds)


def described_inputs(inputs: Inputs, names: Sequence[str], record: Record) -> Mapping[str, str]:
    """Return how every input varies between its samples, in words, and who states it."""
    if not record.has_time:
        return {}
    result = {}
    for name, between in zip(names, between_samples(inputs, names, record), strict=True):
        who = "as the record says"
        if inputs != "record" or name not in record.hold:
            who = "as assumed without a hold" if inputs == "record" else "as stated"
            who += f"; if wrong, delays change by half a step, {number(500 * record.step)} ms"
        result[name] = f"{between}, {who}"

    return result


ERRORS: dict[str, ErrorDistribution] = {"normal": NormalErrors(), "huber": HuberErrors()}
"""The included distributions of errors by name."""

ROWS_CONDITION = "independent errors of equal variance in each output"
SPECTRUM_CONDITION = (
    "errors of the outputs whose size changes slowly over the band, as in light turbulence, and "
    "known inputs"
)


@frozen
class TimeCriterion(AnyCriterion):
    """The likelihood of normal errors of the outputs, which all criteria in time share.

    The past of a delayed input, before the record or during a gap, is unknown. If an input rests at
    the beginning of a gapless stretch (exactly constant over the first 5 samples and clearly longer
    than it holds its values later), it is assumed to have rested before. If it moves, outputs are
    not compared for the largest delay within the bounds of its parameter: a generous upper bound
    costs data, and the fit warns if it costs more than 5 % of a record.

    Parameters
    ----------
    noise : "diagonal", "full", mapping of output to standard deviation, or ErrorCovariance
        Variances or a full covariance estimated with the parameters (maximum likelihood: the cost
        is the logarithm of the determinant of the residual covariance), or known standard
        deviations in the units of the outputs, see `gb.formulation.ErrorCovariance` for a known
        covariance of your own. Every record has variances of its own; those with
        fewer than 12 samples of an output share one if they have the same model and outputs.
    inputs : "record", "linear" or "held"
        How inputs vary between their samples: as the record says (`Record.hold`; an unknown input
        is assumed to be linear, which the result states), or all linear, or all held. If a held
        input reaches an output directly, the cost is discontinuous at integer-sample delays: give
        several starts.
    biases : sequence of str
        Outputs and inputs with an unknown constant error of measurement: the parameter
        ``<name>_bias`` is the measured minus the true value. In a sum, every record has its own,
        see `Sum`.
    initial : mapping of state to value or function of the parameters
        Known states at the first sample of the record. All others, and the states after a gap, are
        estimated.

    Attributes
    ----------
    corrects_states : bool
        Whether the residuals of a sample correct the states, by the gains of `gains`.

    Source: Klein and Morelli, Aircraft System Identification, 2nd ed., chapter 6.
    """

    noise: Literal["diagonal", "full"] | Values | ErrorCovariance = "diagonal"
    inputs: Inputs = "record"
    biases: Sequence[str] = ()
    initial: Mapping[str, float | ParameterFormula] = field(default_factory=dict)

    condition = "stationary output errors with the autocorrelation of the residuals"
    is_likelihood = True
    corrects_states: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Check the options."""
        normalize(self, noise=stated_noise(error_covariance(self.noise)))
        require_inputs(self.inputs)
        normalize(self, biases=as_names(self.biases))
        if not isinstance(self.initial, Mapping):
            raise TypeError(
                f"initial is {self.initial!r:.60}: give {{state: value or function of the "
                "parameters}."
            )

        for name, value in self.initial.items():
            if not (is_finite_number(value) or callable(value)):
                raise ValueError(
                    f"initial gives {name!r} the value {value!r}: give a finite number or a "
                    "function of the parameters."
                )

    @property
    def error_covariance(self) -> ErrorCovariance:
        """How accurate the outputs are."""
        return error_covariance(self.noise)

    @property
    def error_distribution(self) -> ErrorDistribution:
        """How the errors of the outputs are distributed."""
        return ERRORS["normal"]

    @property
    def description(self) -> str:
        """The rule in words."""
        return f"{self.rule}, {self.error_covariance.description}"

    @property
    def bias_names(self) -> tuple[str, ...]:
        """Names of the parameters that are constant errors of signals."""
        return tuple(map(bias_name, self.biases))

    def contains(self, other: AnyCriterion) -> bool:
        """Return whether this is the `other` criterion, perhaps with more biases."""
        if not isinstance(other, TimeCriterion) or not {*other.biases} <= {*self.biases}:
            return False
        return self == replace(other, biases=self.biases)

    def disturbed(self, model: Model, record: Record) -> Model:
        """Return the model with the states of the disturbances that the criterion assumes."""
        return undisturbed(model)

    def compared(self, model: Model, record: Record) -> tuple[str, ...]:
        """Return the outputs of the model that are in the record.

        Raises
        ------
        ValueError
            If an input is missing, none of the outputs is there, a named signal does not exist, or
            the model is not static and the record has no time.
        """
        label = model.label
        # A static model needs no time: its rows may be in any order.
        if not model.is_static:
            require_time(record, f"the dynamic model {label}")
        outputs = modeled_outputs(model, record.signals, record.signals, "record")

        require_known(
            self.biases, (*outputs, *model.input_names), "measured output or input", label
        )
        require_known(self.initial, model.state_names, "state", label)
        self.check_noise(model, outputs)
        return outputs

    def check_noise(self, model: Model, outputs: Sequence[str]) -> None:
        """Raise ValueError if a compared output has no known standard deviation."""
        if isinstance(self.noise, Mapping):
            require_known(self.noise, model.output_names, "output", model.label)
        self.error_covariance.covariance_of(outputs)

    def parameters(self, model: Model, record: Record) -> dict[str, Parameter]:
        """Return the unknowns that the criterion adds to those of the model: biases, then gains."""
        gains = self.gains(model, self.compared(model, record))
        result = {
            bias: bias_parameter(name, record)
            for bias, name in zip(self.bias_names, self.biases, strict=True)
        }
        # With process noise, the gains follow from the steady Kalman filter. Otherwise all runs
        # begin without corrections, which is output error.
        for state, output in () if self.driven() else gains:
            result[f"K_{state}_{output}"] = Parameter(
                0.0,
                starts=(0.0, 0.0),
                unit=f"[{state}/{output}]",
                about=f"correction of {state} by {output}",
            )

        return result

    def spectrum_parameters(self, spectrum: TransientSpectrum) -> dict[str, Parameter]:
        """Return the unknowns that the criterion adds to those of the model for a spectrum."""
        return {}

    def gains(self, model: Model, outputs: Sequence[str]) -> tuple[tuple[str, str], ...]:
        """Return the pairs of state and output with a gain, ``K_<state>_<output>``."""
        return ()

    def driven(self) -> tuple[str, ...]:
        """Return the states whose process noise is estimated, from which the gains then follow."""
        return ()


@frozen
class OutputError(TimeCriterion):
    """Maximum likelihood with all errors in the measured outputs; the model is simulated.

    For a `TransientSpectrum` it compares the transforms and estimates the states at both ends;
    `inputs`, `biases` and `initial` are for records.

    Outputs at the beginning of a record that depend on a delayed input from before it are left out,
    unless that input is at rest there, see `TimeCriterion`.

    Parameters
    ----------
    errors : "normal", "huber" or ErrorDistribution
        How the errors are distributed, see `gb.formulation.ErrorDistribution` for one of your own.
        With "huber", errors beyond 1.345 standard deviations count as 1.345, so that outliers of a
        sensor do not decide the estimate; the standard deviation follows from the median. Standard
        errors are those of this M-estimator, with 5 % more variance for normal errors. The cost is
        that of the record with its outliers moved to this bound. Only for records.

    Examples
    --------
    >>> from greybox.models.specific_force import BodyDrag
    >>> from greybox.problems import nanobench_drag
    >>> record = nanobench_drag.data()[0]
    >>> offsets = gb.OutputError(biases=("a_x", "a_y"))  # constant errors of the sensors
    >>> fit = gb.fit(gb.Problem(BodyDrag(), record, criterion=offsets), starts=1)
    >>> fit.converged
    True
    """

    errors: Literal["normal", "huber"] | ErrorDistribution = "normal"
    rule = "output error"

    def __post_init__(self) -> None:
        """Check the options."""
        super().__post_init__()
        if isinstance(self.errors, ErrorDistribution):
            # An included one has its name, so that both statements are equal and can be stored.
            names = [name for name, included in ERRORS.items() if included == self.errors]
            normalize(self, errors=names[0] if names else self.errors)
        elif self.errors not in [*ERRORS]:
            raise ValueError(
                f"errors is {self.errors!r}: give 'normal', 'huber' or an ErrorDistribution."
            )

    @property
    def error_distribution(self) -> ErrorDistribution:
        """How the errors of the outputs are distributed."""
        return ERRORS[self.errors] if isinstance(self.errors, str) else self.errors

    @property
    def description(self) -> str:
        """The rule in words."""
        words = self.error_distribution.description
        return f"{super().description}, {words}" if words else super().description

    def condition_on(self, data: Any) -> str:
        """Return the condition; errors of rows without a time cannot be correlated."""
        if isinstance(data, TransientSpectrum):
            return SPECTRUM_CONDITION
        return self.condition if data.has_time else ROWS_CONDITION


@frozen
class PredictionError(TimeCriterion):
    """Maximum likelihood with process noise (wind): the model predicts one sample ahead.

    Innovations form: x[k+1] = F(x[k] + K e[k], u), with e the difference of measured and predicted
    outputs and a constant gain K that is estimated with the parameters; its entries are named
    ``K_<state>_<output>``. With `process_noise` or `disturbance` (filter error), K is the gain of
    the steady Kalman filter instead, which also gives the covariance of e. Instead of a gain for
    every pair, the parameters are then ``w_<state>`` for each of these states and ``v_<output>``
    for each output. Without process noise (``w_<state>`` = 0), this is output error.

    Outputs at the beginning of a record that depend on a delayed input from before it are left out,
    unless that input is at rest there, see `TimeCriterion`.

    Source: Ljung, System Identification, 2nd ed., section 4.3; Klein and Morelli, chapter 6;
    Jategaonkar, Flight Vehicle System Identification, 2nd ed., chapter 5.

    Parameters
    ----------
    corrected : sequence of str
        The states that the innovations correct; by default all.
    process_noise : sequence of str
        The states whose derivatives have white noise, of intensity ``w_<state>`` in units of the
        state per √s, as in `virtual_flight`. The noise of the sensors is white, too, with a
        standard deviation ``v_<output>``. The filter is that of the linearization about the means
        of the record; a sample at which an output is missing is not compared.
    disturbance : mapping of str to 'colored'
        The states whose derivatives have a gust, a further state ``gust_<state>`` that white noise
        of intensity ``w_gust_<state>`` drives with the time constant ``T_gust_<state>``. An output
        that contains such a derivative, such as an acceleration, contains the gust, too.

    Examples
    --------
    >>> from greybox.models.specific_force import RotorThrust
    >>> from greybox.problems import nanobench_thrust
    >>> record = nanobench_thrust.data()[0]
    >>> gusty = gb.Problem(RotorThrust(), record, criterion=gb.PredictionError())
    >>> gb.fit(gusty, starts=1).converged
    True
    """

    corrected: Sequence[str] = ()
    process_noise: Sequence[str] = ()
    disturbance: Mapping[str, str] = field(default_factory=dict)
    rule = "prediction error, one sample ahead"
    condition = "stationary innovations that no past input or output predicts"
    corrects_states = True

    def __post_init__(self) -> None:
        """Check the options."""
        super().__post_init__()
        normalize(self, process_noise=as_names(self.process_noise))
        if not isinstance(self.disturbance, Mapping) or {*self.disturbance.values()} - {"colored"}:
            raise ValueError(f"disturbance is {self.disturbance!r}: give {{state: 'colored'}}.")
        if self.driven() and self.corrected:
            raise ValueError(
                "process_noise and disturbance say which states are corrected: leave out corrected."
            )
        if self.driven() and self.error_covariance != EstimatedVariances():
            raise ValueError(
                "with process_noise or disturbance, sensors have the parameters v_<output>: leave "
                f"out noise={self.noise!r}, and give deviations that are known as "
                "fixed={'v_<output>': ...}."
            )

    def disturbed(self, model: Model, record: Record) -> Model:
        """Return the model with a state for every colored disturbance.

        Its time constant lies between a sample, below which it is white, and the record.
        """
        own: Any = undisturbed(model)
        if not self.disturbance or not own.state_names:
            return own
        bounds = record.step, record.duration
        return ColoredDisturbance(own, *((state, bounds) for state in self.disturbance))

    def parameters(self, model: Model, record: Record) -> dict[str, Parameter]:
        """Return the unknowns that the criterion adds: biases, and gains or sizes of noise."""
        result = super().parameters(model, record)
        for state in self.driven():
            result[f"w_{state}"] = Parameter(
                0.0,
                bounds=(0.0, math.inf),
                starts=(0.0, 0.0),
                unit=f"[{state}]/√s",
                about=f"process noise on the derivative of {state}",
            )

        for output in self.compared(model, record) if self.driven() else ():
            spread = float(np.nanstd(record[output])) or 1.0
            result[f"v_{output}"] = Parameter(
                0.1 * spread,  # until the residuals show the noise
                bounds=(1e-5 * spread, math.inf),  # far below the resolution of sensors
                # Manoeuvres of unlike sizes share a sensor, so that their boxes must overlap.
                starts=(1e-5 * spread, spread),
                unit=record.units.get(output, "1"),
                about=f"standard deviation of the noise of {output}",
            )
        return result

    def contains(self, other: AnyCriterion) -> bool:
        """Return whether this is the `other` criterion, perhaps with more gains or noise."""
        # Without gains and without process noise it is output error.
        if isinstance(other, OutputError):
            return OutputError(self.noise, self.inputs, self.biases, self.initial).contains(other)
        if not isinstance(other, PredictionError):
            return False

        if self.driven() or other.driven():
            has_all = set() < {*other.driven()} <= {*self.driven()}
        else:  # without names, all states are corrected
            has_all = not self.corrected or set() < {*other.corrected} <= {*self.corrected}
        own = attributes(self, "corrected", "process_noise", "disturbance")
        return has_all and super().contains(replace(other, **own))

    def driven(self) -> tuple[str, ...]:
        """Return the states with process noise."""
        return (*self.process_noise, *map(gust_on, self.disturbance))

    def gains(self, model: Model, outputs: Sequence[str]) -> tuple[tuple[str, str], ...]:
        """Return every pair of a corrected state (with process noise: any) and an output."""
        states, kind = model.state_names, type(self).__name__
        if not states:
            raise ValueError(
                f"{model.label} declares no states, which {kind} corrects: use OutputError(), or "
                "state the model as a StateSpace."
            )

        require_known((*self.corrected, *self.driven()), states, "state", model.label)
        return tuple((state, output) for state in self.corrected or states for output in outputs)


def modeled_outputs(
    model: Model, inputs: Iterable[str], outputs: Iterable[str], noun: str
) -> tuple[str, ...]:
    """Return the outputs of the model that are among those of the data.

    Raises
    ------
    ValueError
        If an input is missing, or all outputs are.
    """
    for name in model.input_names:
        if name not in inputs:
            raise ValueError(
                f"{model.label} needs the input {name!r}, which the {noun} does not have: rename "
                f"one of its signals, {', '.join(inputs) or 'none'}."
            )

    compared = tuple(name for name in model.output_names if name in outputs)
    if not compared:
        raise ValueError(
            f"the {noun} has none of the outputs of {model.label} "
            f"({', '.join(model.output_names)}); it has {', '.join(outputs) or 'none'}."
        )

    return compared
