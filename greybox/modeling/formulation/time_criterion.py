"""What all criteria for records share: the likelihood of normal errors of the outputs."""

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import ClassVar, Literal

from greybox.data.files.argument_checks import as_names, is_finite_number
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.files.normalization import normalize
from greybox.data.files.public import public
from greybox.data.record import Record, require_time
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.modeling.colored_disturbance import undisturbed
from greybox.modeling.formulation.criterion import AnyCriterion
from greybox.modeling.formulation.error_covariance import (
    ErrorCovariance,
    error_covariance,
    stated_noise,
)
from greybox.modeling.formulation.input_assumptions import Inputs, require_inputs
from greybox.modeling.formulation.modeled_outputs import modeled_outputs
from greybox.modeling.formulation.signal_bias import bias_name, bias_parameter
from greybox.modeling.model import Model, ParameterFormula, require_known
from greybox.modeling.parameter import Parameter
from greybox.statistics.error_distribution import ErrorDistribution, NormalErrors


@public
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

    Examples
    --------
    >>> [isinstance(c, gb.TimeCriterion) for c in (gb.OutputError(), gb.RelativeError())]
    [True, False]
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
        return NormalErrors()

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
