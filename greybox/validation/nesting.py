"""Whether one model is another one with parameters removed.

A parameter has the same name in both models. Those that only the larger fit estimates must
remove their terms at zero, at one, at a bound, or where the smaller fit holds them. The equations
of both models are then compared at random values.
"""

import itertools
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from greybox.estimate.fitted_part import FittedPart
from greybox.estimate.result import Fit
from greybox.files.arrays import Array, StringPair, Values, by_name
from greybox.files.text_table import listed
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import Model
from greybox.modeling.realization import dynamics
from greybox.modeling.state_space import StateSpace
from greybox.validation.same_data import count_unknowns

Equations = Mapping[StringPair, NDArray[np.inexact]]  # of 40 points each, by kind and name

# What a criterion may add to that of the smaller model: parameters.
ADDED_SETTINGS = ("biases", "corrected", "process_noise", "disturbance")


class NotNestedError(ValueError):
    """The reason why one model is not another one with parameters removed."""


def nested_values(small: Fit, large: Fit, labels: StringPair) -> Values:
    """Return the values at which the parameters that only `large` has free make it `small`.

    Raises
    ------
    NotNestedError
        If there are no such values.
    ValueError
        If the models are nested, but have no valid test.
    LookupError
        If a loaded fit does not know its model.
    """
    parts = ([_Part(fit.model_of(k), p) for k, p in enumerate(fit.parts)] for fit in (small, large))
    pairs = list(zip(*parts, strict=True))
    if not all(b.extends(a) for a, b in pairs):
        raise NotNestedError(
            f"{' and '.join(labels)} differ in their criteria, delays, ties or other settings"
        )
    # Standard deviations of sensors are parameters if there is process noise, else implicit.
    implicit = {
        b.names[name]
        for _, b in pairs
        for name in b.part.added
        if name.startswith("v_") and not name.endswith("_bias")
    }
    terms = [name for name in large.free if name not in {*small.free, *implicit}]
    if not terms or count_unknowns(large) <= count_unknowns(small):
        raise NotNestedError(f"{labels[1]} estimates no more numbers than {labels[0]}")

    sources = {b.names[n]: a.names[n] for a, b in pairs for n in b.names if n in a.names}
    # The larger model has the values that are drawn, except where it fixes them.
    shared = {n: source for n, source in sources.items() if large.by_name[n].kind != "fixed"}
    draws = [(d, large.estimate | {n: d[shared[n]] for n in shared}) for d in _draws(small)]

    def is_small(values: Values) -> bool:
        """Return whether the larger model is the smaller one where its terms have these values."""
        return all(
            _agree(a.equations(draw), b.equations({**other, **values}))
            for draw, other in draws
            for a, b in pairs
        )

    held = {name: small.estimate[sources[name]] for name in terms if name in sources}
    of_models = {b.names[name] for _, b in pairs for name in b.model.parameters}
    unknown = [name for name in terms if name not in held]
    choices = []
    for name in unknown:
        # A term vanishes at zero, a factor or an exponent at one, and some only at a bound. A bias
        # or a gain, which the criterion adds and not the model, is absent at zero.
        low, high = large.by_name[name].bounds
        values = (0.0, 1.0, low, high) if name in of_models else (0.0,)
        choices.append([v for v in values if low <= v <= high and math.isfinite(v)])
    # 256 are all combinations of four terms; of more terms, the first ones are zero.
    combinations = itertools.islice(itertools.product(*choices), 256)
    candidates = (by_name(unknown, values) for values in combinations)
    removed = next(filter(is_small, candidates), None)
    if removed is None:
        place = f" where {listed(unknown)} is 0, 1 or at a bound" if unknown else ""
        raise NotNestedError(f"{labels[1]} is not {labels[0]}{place}")

    values = {name: {**held, **removed}[name] for name in terms}
    # Davies (1977), Biometrika 64: the ratio does not have the distribution of the test.
    moved = {name: values[name] + 0.1 * max(abs(values[name]), 1.0) for name in terms}
    idle = [n for n in terms if n in of_models and is_small(removed | {n: moved[n]})]
    if idle:
        raise ValueError(
            f"{listed(idle)} of {labels[1]} has no effect where the other terms are as in "
            f"{labels[0]}, so no nested test is valid: fix {listed(idle)} to test the others."
        )
    return values


def _draws(fit: Fit) -> list[Values]:
    """Return five sets of values about the estimate; fixed ones as they are."""
    # Formulas that differ agree at a random point with probability zero.
    random = np.random.default_rng(0)
    moving = {q.name: q.value for q in fit.quantities if q.kind != "fixed"}
    return [
        fit.estimate | {n: v + 0.3 * (abs(v) or 1.0) * random.normal() for n, v in moving.items()}
        for _ in range(5)
    ]


class _Part:
    """A part of a fit, with its model and the names of its parameters in the fit."""

    def __init__(self, model: Model, part: FittedPart) -> None:
        self.model = model
        self.part = part
        self.names = {name: part.outside(name) for name in (*model.parameters, *part.added)}
        self._dynamics = dynamics(model) if isinstance(model, StateSpace) else None

    def extends(self, other: "_Part") -> bool:
        """Return whether this part differs from a smaller one in nothing but the equations."""
        has_all_terms = {*other.part.added} <= {*self.part.added} and self.part.tied in (
            {},
            other.part.tied,
        )
        return has_all_terms and self._settings() == other._settings()

    def _settings(self) -> list[object]:
        part = self.part
        # Only output error may assume errors that are not normal.
        settings = {"errors": "normal", **part.settings}
        settings = {name: v for name, v in settings.items() if name not in ADDED_SETTINGS}
        # Output error is prediction error with gains of zero.
        criterion = part.criterion_class.replace("PredictionError", "OutputError")
        others = [getattr(part, name, None) for name in ("at", "sine", "inputs")]
        return [criterion, settings, part.delay, part.weight, sorted(part.constraints), *others]

    def equations(self, values: Values) -> Equations:
        """Return derivatives, outputs and delays by name, or the response, at 40 points."""
        p = {name: values[self.names[name]] for name in self.model.parameters}
        system = self._dynamics
        if system is None:
            response = frequency_response(self.model, p, np.geomspace(0.01, 30, 40))
            return {("response", ""): response.response}
        x, u = (np.reshape([*map(_signal, n)], (-1, 40)) for n in (system.states, system.inputs))
        point = np.tile(np.reshape([*p.values()], (-1, 1)), 40)
        blocks = (
            ("derivative", system.states, system.derivative(x, u, point)),
            ("output", system.outputs, system.output(x, u, point)),
            ("delay", system.inputs, system.delay(point)),
        )
        return {
            (kind, name): row
            for kind, names, rows in blocks
            for name, row in zip(names, np.asarray(rows), strict=True)
        }


def _signal(name: str) -> Array:
    """Return 40 values of a state or an input, the same ones in every model."""
    # Values of either sign over decades: kinks, saturations and powers all have an effect there.
    random = np.random.default_rng([*name.encode()])
    return random.choice([-1.0, 1.0], 40) * 10 ** random.uniform(-2, 1.5, 40)


def _agree(expected: Equations, rows: Equations) -> bool:
    """Return whether all expected rows are there, equal up to rounding, and mostly finite."""
    if not expected.keys() <= rows.keys():
        return False
    a, b = (np.array([of[name] for name in expected]) for of in (expected, rows))
    sizes = np.abs(a[np.isfinite(a)])
    # A thousand times the rounding of a long formula; what cancels leaves 1e-14 of a term.
    atol = 1e-14 * np.max(sizes, initial=0.0)
    return 10 * sizes.size >= a.size and np.allclose(b, a, rtol=1e-9, atol=atol, equal_nan=True)
