"""A model at one estimate: values, their covariance, and the assumptions of the fit."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from greybox.data.files.argument_checks import is_finite_number
from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values, places_of, selected
from greybox.data.record import Record, require_time
from greybox.modeling.formulation.input_assumptions import Inputs, between_samples
from greybox.modeling.formulation.output_error import OutputError
from greybox.modeling.formulation.prediction_error import PredictionError
from greybox.modeling.formulation.signal_bias import bias_name
from greybox.modeling.formulation.time_criterion import TimeCriterion
from greybox.modeling.model import Model, require_known
from greybox.modeling.parameter import Parameters
from greybox.modeling.realization import Dynamics, dynamics


@runtime_checkable
class Estimate(Protocol):
    """The result of a fit, which has its model, as `greybox.Fit`."""

    def at_estimate(
        self, model: Model | None, *, inputs: Inputs | None, part: int | None, record: Record | None
    ) -> "ModelAtEstimate":
        """Return a model, by default the fitted one, at the estimate of a part."""
        ...


@frozen
class ModelAtEstimate:
    """A model with values, ready to be simulated.

    Attributes
    ----------
    label : str
        Name of the model.
    system : Dynamics
    names, q : tuple of str, (declared,) array
        The model's parameters, then biases of sensors and gains of the innovations, and their
        values.
    covariance : (declared, declared) array or None
        Covariance of these values; None for plain numbers. It is zero for one that its bound holds,
        which counts as exact, and NaN for a value that the data do not determine.
    criterion : TimeCriterion
        How inputs run between samples, which signals are biased, and whether innovations correct
        the states.
    part : FittedRecord or None
        The record to which the values were fitted, see `greybox.assessment.fitted_part`.
    declared : mapping of name to Parameter
        The model's parameters.
    own : tuple of str
        Names of values that belong to that record, not to the model: biases of its sensors, and
        parameters that each record of the fit has for itself.
    held : tuple of bool
        Which inputs are held between samples, see `driven_by`.
    """

    label: str
    system: Dynamics
    names: tuple[str, ...]
    q: Array
    covariance: Array | None
    criterion: TimeCriterion
    part: Any
    declared: Parameters
    own: tuple[str, ...] = ()
    held: tuple[bool, ...] = ()

    @property
    def p(self) -> Array:
        """The parameters of the model alone."""
        return self.q[: len(self.system.parameters)]

    @property
    def delays(self) -> Array:
        """The delay of every input (m,), s."""
        return self.system.delay(self.p).full().ravel()

    @property
    def uncertain(self) -> IntArray:
        """Indices of the values with a standard error, also an unknown one."""
        if self.covariance is None:
            return np.zeros(0, dtype=int)
        variance = np.diag(self.covariance)
        return np.flatnonzero(np.isnan(variance) | (variance > 0))

    def driven_by(self, record: Record) -> "ModelAtEstimate":
        """Return the model with the inputs of a record, as they run between its samples.

        If neither the criterion nor the record states how an input runs, it runs as in the fit.

        Raises
        ------
        ValueError
            If the model has states or delays, and the record has no time.
        """
        if self.system.states or self.system.delayed:
            require_time(record, f"the dynamic model {self.label}")

        # Inputs vary as in the fit, unless this record says otherwise.
        assumed = self.part.data.hold if self.part else {}
        between = between_samples(self.criterion.inputs, self.system.inputs, record, assumed)
        system = self.system.later([assumption.late for assumption in between])
        return replace(self, system=system, held=tuple(assumption.held for assumption in between))

    def noise(self, outputs: tuple[str, ...]) -> Array | None:
        """Return the covariance (k, k) of the errors of these outputs; None if unknown."""
        if self.part is None or not set(outputs) <= set(self.part.outputs):
            return None
        places = places_of(outputs, self.part.outputs)
        return self.part.noise[np.ix_(places, places)]


def model_at(
    model: Model | Estimate,
    values: Values | Estimate | None = None,
    *,
    inputs: Inputs | None = None,
    part: int | None = None,
    record: Record | None = None,
) -> ModelAtEstimate:
    """Return a model at its values; a `Fit` may replace both, with its part for this `record`.

    Without values, the parameters have their declared starts.

    Raises
    ------
    TypeError, ValueError
        If they do not fit together, or the fit did not converge.
    LookupError
        If the model of a loaded fit cannot be imported.
    """
    is_fit = isinstance(model, Estimate)
    if is_fit and values is not None:
        raise TypeError(
            f"the model is a Fit, which has an estimate of its own, so {values!r:.80} is no "
            "argument: leave it out, or give a record by name, record=r."
        )
    if not is_fit and not isinstance(model, Model):
        raise TypeError(f"model is {model!r:.80}: give an instance such as LinearTilt(), or a Fit.")
    fit = model if is_fit else values
    if isinstance(fit, Estimate):
        return fit.at_estimate(None if is_fit else model, inputs=inputs, part=part, record=record)
    declared = {} if values is None else values
    if not isinstance(declared, Mapping):
        raise TypeError(f"values is {values!r:.60}: give {{name: value}} or a Fit.")
    assert isinstance(model, Model)
    return _of_values(model, declared, "record" if inputs is None else inputs)


def _of_values(model: Model, given: Values, inputs: Inputs) -> ModelAtEstimate:
    system = dynamics(model)
    # A parameter of the model may itself be called `<signal>_bias`.
    extra = given.keys() - model.parameters.keys()
    biases = tuple(n for n in (*model.output_names, *model.input_names) if bias_name(n) in extra)
    gains = tuple((s, o) for s in system.states for o in system.outputs if f"K_{s}_{o}" in extra)
    added = [*map(bias_name, biases)] + [f"K_{s}_{o}" for s, o in gains]
    require_known(given, (*model.parameters, *added), "parameter", model.label)
    for name, value in given.items():
        # A result of numpy may be an array without dimensions.
        if not is_finite_number(np.asarray(value)[()]):
            raise ValueError(
                f"values gives {name!r} the value {value!r:.60}: give a finite number."
            )
    # Parameters first, then biases and gains: the criterion expects this order.
    values = dict(model.values(selected(given, model.parameters)))
    values |= {name: float(given[name]) for name in added}
    criterion = criterion_of(inputs, biases, gains)
    return ModelAtEstimate(
        model.label,
        system,
        tuple(values),
        np.array([*values.values()]),
        None,
        criterion,
        None,
        model.parameters,
    )


def criterion_of(
    inputs: Inputs, biases: tuple[str, ...], gains: tuple[tuple[str, str], ...]
) -> TimeCriterion:
    """Return the criterion under which a model runs, with innovations if there are `gains`."""
    kind = PredictionError if gains else OutputError
    return kind(inputs=inputs, biases=biases)
