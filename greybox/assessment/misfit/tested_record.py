"""A record as causes of misfit look at it: its signals, and where terms can act on it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from greybox.assessment.misfit.equations import Equation, dynamic_equations
from greybox.assessment.misfit.signal_changes import delayed, filtered, following, rate
from greybox.assessment.misfit.term import RecordTerm, Wording
from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.disturbances import DisturbedRecord, Effect
from greybox.modeling.added_terms import Formula
from greybox.modeling.formula_arguments import Names
from greybox.modeling.state_space import StateSpace

Result = TypeVar("Result")

JUMPS = (-0.25, 0.0, 0.25)  # of a parameter, over the samples from their middle
# Time constants of lags and delays, over the rms of an input over that of its rate. The first one
# is less than a sample: the effect of the rate alone, which a delay of any size has.
TIMES = (0.001, 0.3, 1.0, 3.0)

NO_GAIN = Wording(
    "an effect of {signal}, whose gain is nearly zero",
    "other starts or wider bounds of the parameters that multiply u.{signal}",
)


@dataclass(frozen=True)
class Place:
    """Where a term acts: places are equal if the same function takes the same index."""

    function: Callable[[int, Array], Effect]
    index: int

    def __call__(self, values: Array) -> Effect:
        """Return the effect on the record of values (c, samples) there."""
        return self.function(self.index, values)


@frozen
class Input:
    """An input (samples,) of a record."""

    name: str
    values: Array
    place: Place
    step: float
    is_held: bool

    @property
    def varies(self) -> bool:
        """Whether it does anything."""
        return bool(np.ptp(self.values) > 0)

    @cached_property
    def has_steps(self) -> bool:
        """Whether it mostly does not change: steps are no response of a controller."""
        return not np.median(np.abs(np.diff(self.values)))

    def term(
        self, wording: Wording, values: Array, *, level: float = 0.0, scale: float | None = None
    ) -> RecordTerm:
        """Return a term that adds to this input.

        Terms without a time have a factor with the same limit, in samples: seconds mean little for
        a tank, and much for a valve.
        """
        return RecordTerm(
            wording,
            self.name,
            values=values,
            effect=self.place,
            level=level,
            scale=self.step if scale is None else abs(scale),
            other_wording=self.without_gain,
        )

    def without_gain(self, size: float) -> Wording | None:
        """Return that the gain is nearly zero, where only a time beyond the record would do."""
        return NO_GAIN if abs(size) > len(self.values) * self.step else None


@frozen
class Output:
    """A simulated output (samples,) of a record."""

    name: str
    values: Array
    place: Place


class TestedRecord:
    """A record along its best trajectory, with its signals by name.

    Parameters
    ----------
    record : DisturbedRecord
    held : sequence of str
        Parameters that a bound or a constraint holds.
    candidates : mapping of str to function
        Terms of the user, tried in every equation.
    earlier : sequence of TestedRecord
        Those before it, whose inputs it may repeat.
    """

    __test__ = False  # no test, whatever its name

    def __init__(
        self,
        record: DisturbedRecord,
        held: Sequence[str] = (),
        candidates: Mapping[str, Formula] | None = None,
        earlier: Sequence["TestedRecord"] = (),
    ) -> None:
        self.record, self.held, self.candidates = record, held, candidates or {}
        self.earlier = earlier
        self.part, self.log, self.step = record.part, record.part.model.record, record.step
        self.ones = np.ones(record.part.samples)
        self._results = dict[Callable[["TestedRecord"], Any], Any]()

    def once(self, function: Callable[["TestedRecord"], Result]) -> Result:
        """Return a function of this record, which several causes may ask for."""
        if function not in self._results:
            self._results[function] = function(self)
        return self._results[function]

    @property
    def has_equations(self) -> bool:
        """Whether the model has states with names."""
        return isinstance(self.part.problem.model, StateSpace)

    @cached_property
    def equations(self) -> list[Equation]:
        """The equations of the states that may lack a term."""
        return dynamic_equations(self.part)

    @cached_property
    def states(self) -> dict[str, Array]:
        """The states (samples,) by name."""
        return dict(zip(self.part.system.states, self.record.states, strict=True))

    @cached_property
    def all_inputs(self) -> list[Input]:
        """The inputs."""
        rows = zip(
            self.part.system.inputs, self.record.inputs, self.part.model.between, strict=True
        )
        return [
            Input(name, values, self.at_input(j), self.step, between.held)
            for j, (name, values, between) in enumerate(rows)
        ]

    @property
    def inputs(self) -> list[Input]:
        """The inputs that vary."""
        return [u for u in self.all_inputs if u.varies]

    @cached_property
    def outputs(self) -> list[Output]:
        """The outputs."""
        rows = zip(self.part.outputs, self.record.outputs, strict=True)
        return [Output(name, values, self.at_output(k)) for k, (name, values) in enumerate(rows)]

    @cached_property
    def formula_arguments(self) -> tuple[Names, Names, Names]:
        """States, inputs and parameters by name, as formulas take them."""
        inputs = {u.name: u.values for u in self.all_inputs}
        rows = zip(self.part.model.parameters, self.record.parameters, strict=True)
        return Names(self.states), Names(inputs), Names(dict(rows))

    @cached_property
    def _active_parameters(self) -> list[tuple[str, Place]]:
        """The parameters that the fit moves, and where their changes act."""
        model = self.part.model
        # Gains correct for what the model lacks: a gain is not itself a missing term.
        gains = {f"K_{state}_{output}" for state, output in self.part.gains}
        return [
            (model.outside_names[k], Place(self.record.by_parameter, place))
            for place, k in enumerate(model.active)
            if model.parameters[k] not in gains
        ]

    @property
    def free_parameters(self) -> list[tuple[str, Place]]:
        """The parameters that the fit can move alone."""
        return [pair for pair in self._active_parameters if pair[0] not in self.held]

    @property
    def held_parameters(self) -> list[tuple[str, Place]]:
        """The parameters that a bound or a constraint holds."""
        return [pair for pair in self._active_parameters if pair[0] in self.held]

    @cached_property
    def fixed_parameters(self) -> list[tuple[str, Place]]:
        """The parameters that the fit does not move."""
        model = self.part.model
        return [
            (model.outside_names[k], Place(self.record.by_constant, k))
            for k in range(len(self.part.system.parameters))
            if k not in model.active
        ]

    @cached_property
    def time(self) -> Array:
        """The time of the samples, s."""
        return self.part.data.at_samples(self.log.time)[0]

    def at_state(self, index: int) -> Place:
        """Return the place in the equation of a state."""
        return Place(self.record.by_state, index)

    def at_input(self, index: int) -> Place:
        """Return the place at an input."""
        return Place(self.record.by_input, index)

    def at_output(self, index: int) -> Place:
        """Return the place at an output."""
        return Place(self.record.by_output, index)

    def along(self) -> list[Array]:
        """Return a slope and jumps along the record, (samples,) each."""
        slope = np.linspace(-0.5, 0.5, self.part.samples)
        return [slope, *(1.0 * (slope > share) for share in JUMPS)]

    def delayed(self, values: Array, delay: float) -> Array:
        """Return a signal (samples,) delayed by so many seconds."""
        return self.record.by_stretch(delayed, values, delay)

    def rate(self, values: Array) -> Array:
        """Return the rate without later values, which may respond to the present noise."""
        return self.record.by_stretch(rate, values)

    def filtered(self, values: Array, numerator: Sequence[float], poles: Sequence[float]) -> Array:
        """Return a signal (samples,) behind a digital filter, from rest."""
        return self.record.by_stretch(filtered, values, np.array(numerator), np.array(poles))

    def following(self, values: Array, reach: float, *, is_slow: bool) -> Array:
        """Return the lag of what follows a signal by `reach` a sample, or with such a play."""
        return self.record.by_stretch(following, values, reach, is_slow)

    def time_constants(self, values: Array) -> Array:
        """Return the delays and lags that are tried for a signal (samples,), s."""
        speed = np.std(self.rate(values)) + 1e-300
        return np.std(values) / speed * np.array(TIMES)

    def shifts(self, values: Array) -> Iterator[tuple[Array, float]]:
        """Yield delays of a signal (samples,), s, each with what it changes; leads are negative.

        A lead needs later values, which of a signal that a controller moves contain the noise of
        today.
        """
        times = self.time_constants(values).tolist()
        if all(u.has_steps for u in self.all_inputs):
            times += [-T for T in times]
        for T in times:
            yield np.sign(T) * (self.delayed(values, T) - values), T
