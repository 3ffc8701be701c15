"""Prediction error: measured outputs correct the states, sample by sample."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np

from greybox.data.files.argument_checks import as_names
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import attributes
from greybox.data.files.normalization import normalize
from greybox.data.files.public import public
from greybox.data.record import Record
from greybox.modeling.colored_disturbance import ColoredDisturbance, driven_by, undisturbed
from greybox.modeling.disturbance import Disturbance, stated_disturbance
from greybox.modeling.formulation.criterion import AnyCriterion
from greybox.modeling.formulation.error_covariance import EstimatedVariances
from greybox.modeling.formulation.output_error import OutputError
from greybox.modeling.formulation.time_criterion import TimeCriterion
from greybox.modeling.model import Model, require_known
from greybox.modeling.parameter import Parameter


@public
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
    disturbance : mapping of str to 'colored' or Disturbance
        The states whose derivatives have a gust, a further state ``gust_<state>`` that white noise
        of intensity ``w_gust_<state>`` drives with the time constant ``T_gust_<state>``; another
        spectrum is a `gb.formulation.Disturbance` of your own. An output that contains such a
        derivative, such as an acceleration, contains the gust, too.

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
    disturbance: Mapping[str, str | Disturbance] = field(default_factory=dict)
    rule = "prediction error, one sample ahead"
    condition = "stationary innovations that no past input or output predicts"
    corrects_states = True

    def __post_init__(self) -> None:
        """Check the options."""
        super().__post_init__()
        normalize(self, process_noise=as_names(self.process_noise))
        if not isinstance(self.disturbance, Mapping):
            raise ValueError(f"disturbance is {self.disturbance!r}: give {{state: 'colored'}}.")
        stated = {state: stated_disturbance(color) for state, color in self.disturbance.items()}
        normalize(self, disturbance=stated)
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
        """Return the model with the states of every disturbance.

        Their time constants lie between a sample, below which they are white, and the record.
        """
        plain: Any = undisturbed(model)
        if not self.disturbance or not plain.state_names:
            return plain
        times = record.step, record.duration
        disturbed = [(state, times) for state in self.disturbance]
        own = {s: color for s, color in self.disturbance.items() if isinstance(color, Disturbance)}
        # A stored model names its arguments: those of included disturbances are plain.
        return ColoredDisturbance(plain, *disturbed, **({"own": own} if own else {}))

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
        return (*self.process_noise, *driven_by(self.disturbance))

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
