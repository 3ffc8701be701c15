"""Whether one model is another one with parameters removed, fixed or tied.

Parameters of one name are the same in both models. A parameter that only the larger model has must
remove its term at zero, at one or at a bound. The equations of both models are then compared at
random values.
"""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from greybox.estimate.fitted_part import FittedPart, FittedRecord
from greybox.estimate.result import Fit
from greybox.files.text_table import listed
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import Model
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.realization import dynamics
from greybox.modeling.state_space import StateSpace
from greybox.validation.same_data import count_unknowns

Numbers = NDArray[np.inexact]  # real or complex


class NotNestedError(ValueError):
    """The reason why one model is not shown to be another with terms removed.

    Attributes
    ----------
    undecided : bool
        True where the models may be nested all the same, or are and have no valid test; False where
        they are two different models.
    """

    def __init__(self, reason: str, undecided: bool = False) -> None:
        super().__init__(reason)
        self.undecided = undecided


def nested_values(small: Fit, large: Fit, labels: tuple[str, str]) -> dict[str, float]:
    """Return the values at which the terms of the larger model make it the smaller one.

    Terms are the parameters that are free only in the larger model.

    Raises
    ------
    NotNestedError
        If the smaller model is not shown to lie within the larger one.
    """
    for a, b in zip(small.parts, large.parts, strict=True):
        _require_same_assumptions(a, b, labels)
    pairs = _pairs(small, large)
    counterparts = _counterparts(pairs, small, large, labels)

    terms = [n for n in large.free if n not in (*small.free, *_sensor_deviations(small, large))]
    if not terms:
        raise NotNestedError(f"every free parameter of {labels[1]} is also free in {labels[0]}")
    sources = {name: counterparts[name] for name in terms}
    held = {name: small.estimate[source] for name, source in sources.items() if source}
    # A bias or a gain, which the criterion adds and not the model, is absent at zero.
    of_model = {pair.large_part.outside(name) for pair in pairs for name in pair.large.parameters}
    removed = {n: 0.0 for n in terms if n not in {*of_model, *held}}
    unknown = [name for name in terms if name not in {*held, *removed}]
    if pairs:
        equations = _Equations(pairs, _draws(small), large, labels)
        removed |= equations.removing(unknown, removed)
        equations.require_effects([n for n in terms if n in of_model], {**removed, **held})

    if count_unknowns(large) <= count_unknowns(small):
        raise NotNestedError(f"{labels[1]} estimates no more numbers than {labels[0]}")
    values = {**held, **removed}
    for name, value in values.items():
        low, high = large.by_name[name].bounds
        if not low - 1e-9 * abs(value) <= value <= high + 1e-9 * abs(value):
            raise NotNestedError(
                f"{name} = {value:g}, as in {labels[0]}, is outside the bounds ({low:g}, {high:g}) "
                f"of {labels[1]}"
            )
    return {name: values[name] for name in terms}


def _require_same_assumptions(small: FittedPart, large: FittedPart, labels: Sequence[str]) -> None:
    """Raise if a part of the larger fit differs in more than parameters, or lacks noise terms."""
    models = f"{labels[0]} and {labels[1]}"
    # One of these two criteria is the other with gains of zero.
    for_records = {"greybox:OutputError", "greybox:PredictionError"}
    criteria = {small.criterion_class, large.criterion_class}
    if len(criteria) > 1 and not criteria <= for_records:
        raise NotNestedError(f"{models} have different criteria")
    for name, what in (("delay", "delays"), ("at", "operating points"), ("sine", "amplitudes")):
        if getattr(small, name, None) != getattr(large, name, None):
            raise NotNestedError(f"{models} have different {what}")
    if isinstance(small, FittedRecord) and isinstance(large, FittedRecord):
        if small.inputs != large.inputs:
            raise NotNestedError(f"{models} have different inputs between samples")
        # Gains follow from process noise, where there is any, and are free otherwise.
        gains = (small.driven, large.driven) if large.driven else (small.gains, large.gains)
        same_kind = not small.gains or bool(small.driven) == bool(large.driven)
        if not (same_kind and {*gains[0]} <= {*gains[1]} and {*small.biases} <= {*large.biases}):
            raise NotNestedError(f"{labels[0]} has noise terms or biases that {labels[1]} lacks")

    def settings(part: FittedPart) -> object:
        added = ("biases", "corrected", "process_noise")
        values = {name: value for name, value in part.settings.items() if name not in added}
        return values, part.weight, sorted(part.constraints)

    if settings(small) != settings(large):
        raise NotNestedError(f"{models} also differ in noise, constraints or weights", True)
    if large.tied and small.tied != large.tied:
        raise NotNestedError(f"{labels[1]} has ties that {labels[0]} lacks")


def _sensor_deviations(small: Fit, large: Fit) -> set[str]:
    """Return the standard deviations of sensors: parameters beside process noise, else implicit."""
    return {
        b.outside(f"v_{output}")
        for a, b in zip(small.parts, large.parts, strict=True)
        if isinstance(a, FittedRecord) and isinstance(b, FittedRecord) and b.driven and not a.driven
        for output in a.outputs
    }


@dataclass(frozen=True, eq=False)
class _Pair:
    """The same part of both fits, with its models."""

    small: Model
    large: Model
    small_part: FittedPart
    large_part: FittedPart

    @property
    def counterparts(self) -> dict[str, str | None]:
        """Names of the parameters in the larger fit, and in the smaller one if they are there."""
        in_large, in_small = (
            [*model.parameters, *getattr(part, "added", ())]
            for model, part in ((self.large, self.large_part), (self.small, self.small_part))
        )
        return {
            self.large_part.outside(name): self.small_part.outside(name)
            if name in in_small
            else None
            for name in in_large
        }

    def equations(self, model: Model, p: Mapping[str, float]) -> Numbers:
        """Return the response of a transfer function, or the ODE at random states and inputs."""
        if isinstance(model, StateSpace):
            return self._rows(model, p)
        return frequency_response(model, p, np.geomspace(0.01, 30, 12)).response

    def _rows(self, model: Model, p: Mapping[str, float]) -> Numbers:
        """Return the derivatives, outputs and delays that both models have, at 40 points."""
        order = delay_order(self.large_part.delay)
        large, small, system = (dynamics(m, order) for m in (self.large, self.small, model))
        names = (*large.states, *large.inputs)
        if not {*small.states, *small.inputs} <= {*names}:
            return np.full(1, np.nan)
        # Values of either sign over decades: kinks, saturations and powers all have an effect
        # there.
        random = np.random.default_rng(0)
        signs = random.choice([-1.0, 1.0], (len(names), 40))
        points = signs * 10 ** random.uniform(-2, 1.5, signs.shape)
        x, u = (points[[names.index(n) for n in g]] for g in (system.states, system.inputs))
        values = np.tile(np.reshape([p[name] for name in system.parameters], (-1, 1)), (1, 40))
        outputs = [name for name in small.outputs if name in large.outputs]
        rows = (
            (system.derivative(x, u, values), system.states, small.states),
            (system.output(x, u, values), system.outputs, outputs),
            (system.delay(values), system.inputs, small.inputs),
        )
        return np.vstack(
            [np.asarray(all_rows)[[of.index(name) for name in some]] for all_rows, of, some in rows]
        )


def _pairs(small: Fit, large: Fit) -> list[_Pair]:
    """Return the parts of both fits; empty if the models are not available, but are the same."""
    parts = list(zip(small.parts, large.parts, strict=True))
    try:
        models = [[fit.model_of(k) for k in range(len(fit.parts))] for fit in (small, large)]
    except LookupError:
        if all(a.model == b.model and a.rename == b.rename for a, b in parts):
            return []
        raise NotNestedError(
            "their models are not available: give them to gb.load, models=[...]",
            undecided=set(small.free) <= set(large.estimate),
        ) from None
    return [_Pair(*pair) for pair in zip(*models, *zip(*parts, strict=True), strict=True)]


def _counterparts(
    pairs: Sequence[_Pair], small: Fit, large: Fit, labels: Sequence[str]
) -> dict[str, str | None]:
    """Return the name in the smaller fit of every parameter of the larger one."""
    if not pairs:
        return {name: name if name in small.estimate else None for name in large.estimate}
    names: dict[str, str | None] = {}
    free = {*small.free}
    for name, counterpart in (item for pair in pairs for item in pair.counterparts.items()):
        if names.setdefault(name, counterpart) != counterpart:
            raise NotNestedError(f"{name} of {labels[1]} is several parameters of {labels[0]}")
        if counterpart in free and name in large.estimate and name not in large.free:
            raise NotNestedError(f"{labels[1]} holds {name}, which is free in {labels[0]}")
    return names


def _draws(fit: Fit) -> list[dict[str, float]]:
    """Return five sets of values about the estimate, within the bounds; fixed ones as they are."""
    # Formulas that differ agree at a random point with probability zero. Five points allow for some
    # at which a formula is not finite.
    random = np.random.default_rng(0)
    sets = []
    for _ in range(5):
        values = dict(fit.estimate)
        for q in fit.quantities:
            if q.kind in ("free", "tied"):
                moved = q.value + 0.3 * (abs(q.value) or 1.0) * random.normal()
                values[q.name] = float(np.clip(moved, *q.bounds)) if q.kind == "free" else moved
        sets.append(values)
    return sets


@dataclass(frozen=True, eq=False)
class _Equations:
    """The equations of two fits at the same random values of the smaller one, `draws`."""

    pairs: Sequence[_Pair]
    draws: Sequence[Mapping[str, float]]
    large: Fit
    labels: tuple[str, str]

    def removing(self, names: Sequence[str], values: Mapping[str, float]) -> dict[str, float]:
        """Return values of the named parameters that make the larger model the smaller one."""
        for pair in self.pairs:
            if isinstance(pair.small, StateSpace) != isinstance(pair.large, StateSpace):
                raise NotNestedError(
                    f"the equations of {self.labels[0]} and {self.labels[1]} have different forms",
                    undecided=True,
                )
        # A term vanishes at zero, a factor or an exponent at one, and some models only at a bound.
        choices = [
            [v for v in dict.fromkeys((0.0, 1.0, *bounds)) if math.isfinite(v)]
            for bounds in (self.large.by_name[name].bounds for name in names)
        ]
        combinations: Iterable[tuple[float, ...]] = itertools.product(*choices)
        if len(names) > 3:  # too many combinations: all are zero, or all are one
            combinations = [(value,) * len(names) for value in (0.0, 1.0)]
        for combination in combinations:
            removed = dict(zip(names, combination, strict=True))
            if self._agree({**values, **removed}):
                return removed
        place = f" where {listed(list(names))} is 0, 1 or at a bound" if names else ""
        raise NotNestedError(f"{self.labels[1]} is not {self.labels[0]}{place}")

    def require_effects(self, terms: Sequence[str], values: Mapping[str, float]) -> None:
        """Raise where a term has no effect once another one is removed.

        Source: Davies (1977), Biometrika 64.
        """
        # The data cannot determine such a term where the smaller model is true, so that the ratio
        # does not have the distribution of the test.
        idle = []
        for name in terms if len(terms) > 1 else ():
            moved = values[name] + 0.1 * max(abs(values[name]), 1.0)
            if self._agree({**values, name: moved}, values):
                idle.append(name)
        if idle:
            raise NotNestedError(
                f"{listed(idle)} of {self.labels[1]} has no effect where the other terms are as in "
                f"{self.labels[0]}, so no nested test is valid: fix {listed(idle)} to test the "
                "others",
                undecided=True,
            )

    def _agree(
        self, values: Mapping[str, float], reference: Mapping[str, float] | None = None
    ) -> bool:
        """Compare the larger model at `values` with the smaller one, or itself at `reference`."""
        for pair in self.pairs:
            finite = 0
            for draw in self.draws:
                rows = pair.equations(pair.large, self._of_large(pair, draw, values))
                if reference is None:
                    outside = pair.small_part.outside
                    p = {name: draw[outside(name)] for name in pair.small.parameters}
                    expected = pair.equations(pair.small, p)
                else:
                    expected = pair.equations(pair.large, self._of_large(pair, draw, reference))
                if not _same(rows, expected):
                    return False
                finite += bool(np.isfinite(rows).any())
            if finite < 3:  # agreement where hardly anything is finite means nothing
                return False
        return True

    def _of_large(
        self, pair: _Pair, draw: Mapping[str, float], values: Mapping[str, float]
    ) -> dict[str, float]:
        """Return the larger model's parameters: those in `values`, those drawn, those it fixes."""
        fixed = {q.name for q in self.large.quantities if q.kind == "fixed"}
        drawn = {n: draw[c] for n, c in pair.counterparts.items() if c and n not in fixed}
        p = {**self.large.estimate, **drawn, **values}
        return {name: p[pair.large_part.outside(name)] for name in pair.large.parameters}


def _same(rows: Numbers, expected: Numbers) -> bool:
    """Tell whether two arrays are equal; where one is not finite the other must not be either."""
    finite = np.isfinite(rows)
    if not np.array_equal(finite, np.isfinite(expected)):
        return False
    sizes = np.maximum(np.abs(rows[finite]), np.abs(expected[finite]))
    # A thousand times the rounding of a long formula; what cancels leaves 1e-14 of a term.
    tolerance = np.maximum(1e-9 * sizes, 1e-14 * np.max(sizes, initial=0.0))
    return bool(np.all(np.abs(rows[finite] - expected[finite]) <= tolerance))
