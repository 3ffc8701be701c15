"""Whether one model is another one with parameters removed, fixed or tied.

Parameters of one name are the same in both models. A parameter that only the larger model has must
remove its term at zero, at one or at a bound. The equations of both models are then compared at
random values.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from greybox.estimate.fitted_part import FittedPart, FittedRecord
from greybox.estimate.result import Fit
from greybox.files.text_table import listed
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import Model
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
    implicit: set[str] = set()
    for a, b in zip(small.parts, large.parts, strict=True):
        _require_same_assumptions(a, b, labels)
        # Standard deviations of sensors are parameters beside process noise, else implicit.
        if isinstance(b, FittedRecord) and b.driven and not getattr(a, "driven", True):
            implicit |= {b.outside(f"v_{output}") for output in b.outputs}

    terms = [name for name in large.free if name not in (*small.free, *implicit)]
    if not terms or count_unknowns(large) <= count_unknowns(small):
        raise NotNestedError(f"{labels[1]} estimates no more numbers than {labels[0]}")

    pairs = _pairs(small, large)
    sources = {name: source for pair in pairs for name, source in pair.sources.items()}
    if not pairs:
        sources = {name: name for name in large.estimate if name in small.estimate}
    held = {name: small.estimate[sources[name]] for name in terms if name in sources}
    # A bias or a gain, which the criterion adds and not the model, is absent at zero.
    of_model = {pair.parts[1].outside(name) for pair in pairs for name in pair.models[1].parameters}
    removed = {name: 0.0 for name in terms if name not in {*of_model, *held}}
    if pairs:
        equations = _Equations(pairs, small, large, sources)
        removed |= equations.removing(
            [n for n in terms if n not in {*held, *removed}], removed, labels
        )
        equations.require_effects([n for n in terms if n in of_model], {**held, **removed}, labels)

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
    for (what, a), b in zip(_assumptions(small).items(), _assumptions(large).values(), strict=True):
        if a != b:
            models, undecided = " and ".join(labels), what.startswith("noise")
            raise NotNestedError(f"{models} have different {what}", undecided)
    if isinstance(small, FittedRecord) and isinstance(large, FittedRecord):
        # Gains follow from process noise, where there is any, and are free otherwise.
        gains = (small.driven, large.driven) if large.driven else (small.gains, large.gains)
        same_kind = not small.gains or bool(small.driven) == bool(large.driven)
        if not (same_kind and {*gains[0]} <= {*gains[1]} and {*small.biases} <= {*large.biases}):
            raise NotNestedError(f"{labels[0]} has noise terms or biases that {labels[1]} lacks")
    if large.tied and small.tied != large.tied:
        raise NotNestedError(f"{labels[1]} has ties that {labels[0]} lacks")


def _assumptions(part: FittedPart) -> dict[str, object]:
    """Return what nested models have in common, by its name."""
    added = ("biases", "corrected", "process_noise", "disturbance")
    settings = {name: value for name, value in part.settings.items() if name not in added}
    return {
        # Output error is prediction error with gains of zero.
        "criteria": part.criterion_class.replace("PredictionError", "OutputError"),
        "delays": getattr(part, "delay", None),
        "operating points": getattr(part, "at", None),
        "amplitudes": getattr(part, "sine", None),
        "inputs between samples": getattr(part, "inputs", None),
        "noise, constraints or weights": (settings, part.weight, sorted(part.constraints)),
    }


@dataclass(frozen=True, eq=False)
class _Pair:
    """The same part of both fits: the models and the parts, the smaller one first."""

    models: tuple[Model, Model]
    parts: tuple[FittedPart, FittedPart]

    @property
    def sources(self) -> dict[str, str]:
        """The names in the smaller fit of those parameters of the larger one that are in both."""
        small, large = (
            {name: part.outside(name) for name in (*model.parameters, *getattr(part, "added", ()))}
            for model, part in zip(self.models, self.parts, strict=True)
        )
        return {large[name]: small[name] for name in large if name in small}

    def rows(self, k: int, draws: Sequence[Mapping[str, float]]) -> Numbers:
        """Return the values of the equations of a model at every draw (d, ...)."""
        model, outside = self.models[k], self.parts[k].outside
        points = [{name: draw[outside(name)] for name in model.parameters} for draw in draws]
        if isinstance(model, StateSpace):
            return np.array([self._ode(model, p) for p in points])
        omega = np.geomspace(0.01, 30, 12)
        return np.array([frequency_response(model, p, omega).response for p in points])

    def _ode(self, model: StateSpace, p: Mapping[str, float]) -> Numbers:
        """Return the derivatives, outputs and delays that both models have, at 40 points."""
        small, large, system = map(dynamics, (*self.models, model))
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
        models = [(small.model_of(k), large.model_of(k)) for k in range(len(parts))]
    except LookupError:
        is_contained = set(small.free) <= set(large.estimate)
        if is_contained and all(a.model == b.model and a.rename == b.rename for a, b in parts):
            return []
        raise NotNestedError(
            "their models are not available: give them to gb.load, models=[...]", is_contained
        ) from None
    if any(isinstance(a, StateSpace) != isinstance(b, StateSpace) for a, b in models):
        raise NotNestedError("their equations have different forms", undecided=True)
    return [_Pair(*pair) for pair in zip(models, parts, strict=True)]


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


class _Equations:
    """The equations of two fits at the same random values of the smaller one."""

    def __init__(
        self, pairs: Sequence[_Pair], small: Fit, large: Fit, sources: Mapping[str, str]
    ) -> None:
        draws = _draws(small)
        self._pairs = pairs
        self._large = large
        self._small = [pair.rows(0, draws) for pair in pairs]
        # The larger model has the values that were drawn, except where it fixes them.
        varied = {name: c for name, c in sources.items() if large.by_name[name].kind != "fixed"}
        self._draws = [
            {**large.estimate, **{n: draw[c] for n, c in varied.items()}} for draw in draws
        ]

    def removing(
        self, names: Sequence[str], values: Mapping[str, float], labels: Sequence[str]
    ) -> dict[str, float]:
        """Return values of the named parameters that make the larger model the smaller one."""
        # A term vanishes at zero, a factor or an exponent at one, and some models only at a bound.
        choices = [
            [v for v in dict.fromkeys((0.0, 1.0, *bounds)) if math.isfinite(v)]
            for bounds in (self._large.by_name[name].bounds for name in names)
        ]
        if len(names) > 3:  # too many combinations: all are zero, or all are one
            combinations = [(value,) * len(names) for value in (0.0, 1.0)]
        else:
            combinations = list(itertools.product(*choices))
        for combination in combinations:
            removed = dict(zip(names, combination, strict=True))
            if all(map(_same, self._rows({**values, **removed}), self._small)):
                return removed
        place = f" where {listed(list(names))} is 0, 1 or at a bound" if names else ""
        raise NotNestedError(f"{labels[1]} is not {labels[0]}{place}")

    def require_effects(
        self, terms: Sequence[str], values: Mapping[str, float], labels: Sequence[str]
    ) -> None:
        """Raise where a term has no effect once another one is removed.

        Source: Davies (1977), Biometrika 64.
        """
        # The data cannot determine such a term where the smaller model is true, so that the ratio
        # does not have the distribution of the test.
        idle = []
        for name in terms if len(terms) > 1 else ():
            moved = values[name] + 0.1 * max(abs(values[name]), 1.0)
            if all(map(_same, self._rows({**values, name: moved}), self._rows(values))):
                idle.append(name)
        if idle:
            raise NotNestedError(
                f"{listed(idle)} of {labels[1]} has no effect where the other terms are as in "
                f"{labels[0]}, so no nested test is valid: fix {listed(idle)} to test the others",
                undecided=True,
            )

    def _rows(self, values: Mapping[str, float]) -> Iterator[Numbers]:
        """Return the rows of the larger model, part by part, where its terms have these values."""
        draws = [{**draw, **values} for draw in self._draws]
        return (pair.rows(1, draws) for pair in self._pairs)


def _same(rows: Numbers, expected: Numbers) -> bool:
    """Tell whether two arrays (5, ...) are equal; where one is not finite the other must not be."""
    finite = np.isfinite(rows)
    # Agreement where hardly anything is finite means nothing.
    if not np.array_equal(finite, np.isfinite(expected)) or sum(map(np.any, finite)) < 3:
        return False
    sizes = np.maximum(np.abs(rows[finite]), np.abs(expected[finite]))
    # A thousand times the rounding of a long formula; what cancels leaves 1e-14 of a term.
    tolerance = np.maximum(1e-9 * sizes, 1e-14 * np.max(sizes, initial=0.0))
    return bool(np.all(np.abs(rows[finite] - expected[finite]) <= tolerance))
