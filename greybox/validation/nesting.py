"""Whether one model is another with parameters removed, fixed or tied: shown by their formulas, never by names alone.

Two models are nested when every value of the smaller one's free parameters has a counterpart in the
larger one with the same equations. Names say which counterpart that could be: a parameter that both
have is the same in both, one that the smaller one fixes or ties has that value, and one that it
lacks has a value that removes it, which is looked for among zero and one. Where the models are two
classes, their equations are then evaluated at random points: formulas that differ agree there with
probability zero.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from greybox.estimate.fitted_part import FittedPart, FittedRecord, FittedResponse, FittedSpectrum
from greybox.estimate.result import Fit, Quantity
from greybox.files.arrays import Array
from greybox.files.text_table import counted, listed
from greybox.modeling.model import Model, require_known
from greybox.modeling.model_reference import resolve
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.periodic_motions import response_of_test
from greybox.modeling.realization import Dynamics, dynamics
from greybox.modeling.state_space import StateSpace
from greybox.modeling.transfer_function import TransferFunction

# Points at which formulas are compared: one would do where formulas are analytic; more see both
# sides of a branch.
POINTS = 200
# Frequencies, and vectors of parameters, at which responses are compared that have to be solved
# for.
FREQUENCIES = 12
VECTORS = 5
# Of those points, how many must have a finite value for an agreement to mean something.
FEWEST_FINITE = 3
# Relative difference below which two formulas have the same value: a thousand times the rounding of
# a long formula. Responses about an operating point are solved for by iteration, hence the second.
SAME = 1e-9
SAME_RESPONSE = 1e-6
# Of the largest value of a vector: a smaller difference is rounding of terms that cancel.
ROUNDING = 1e-14
# Relative spread of the parameters about the smaller model's estimate, and the decades of states
# and inputs.
PARAMETER_SPREAD = 0.3
DECADES = (-2.0, 1.5)
# Values that remove a parameter from a formula, as a factor, an exponent or a ratio may have them.
NEUTRAL = (0.0, 1.0)
# Parameters up to which all combinations of these values are tried; beyond it all are zero or all
# are one.
MOST_COMBINED = 4
# The criteria for records of greybox, of which one is the other with gains of zero.
SHIPPED = {"greybox:OutputError", "greybox:PredictionError"}
# Of a value: two that are given to be equal, and a value on its bound.
EQUAL = 1e-9
# Relative singular value below which a direction of parameter space is not one of the smaller
# model.
RANK = 1e-8


@dataclass(frozen=True, eq=False)
class Nesting:
    """How the smaller model lies within the larger one.

    Attributes
    ----------
    terms : tuple of str
        The parameters that are free in the larger one alone.
    point : (p,) array
        The larger one's free parameters at the smaller one's estimate.
    directions : (p, r) array
        Of the larger one's free parameters: those that leave the smaller one.
    on_bound : tuple of str
        The terms whose value in the smaller one is on a bound of the larger one.
    initial_states : int
        How many more initial states the larger one estimates.
    """

    terms: tuple[str, ...]
    point: Array
    directions: Array
    on_bound: tuple[str, ...]
    initial_states: int

    @property
    def dof(self) -> int:
        """How many numbers more the larger one estimates."""
        return self.directions.shape[1] + self.initial_states


class NotNestedError(ValueError):
    """One model is not shown to be another with terms removed; the reason, in words without an end.

    Attributes
    ----------
    undecided : bool
        True when they may be nested all the same, or are, and no test of nested models applies;
        False when they are two different models.
    """

    def __init__(self, reason: str, undecided: bool = False) -> None:
        super().__init__(reason)
        self.undecided = undecided


def nesting(
    small: Fit, large: Fit, labels: tuple[str, str], removed_at: Mapping[str, float] | None = None
) -> Nesting:
    """Tell how `small` lies within `large`.

    `removed_at` has the values at which parameters leave the larger model as the smaller one, as
    the user knows them; they are taken on trust.

    Raises
    ------
    NotNestedError
        If it is not shown to.
    """
    removed_at = removed_at or {}
    require_known(removed_at, large.free, "free parameter", labels[1])
    _require_same_assumptions(small, large, labels)
    slots = _Slots.of(small, large)

    sources = _sources(slots, small, large, labels)
    deviations = _deviations(small, large)
    terms = tuple(name for name in large.free if name not in small.free and name not in deviations)
    stated = {
        name: small.estimate[source]
        for name, source in sources.items()
        if source is not None and name in terms
    }
    absent = tuple(name for name, source in sources.items() if source is None)
    values = _removed(slots, small, large, labels, absent, stated, removed_at)
    if not _same_noise(small, large):
        raise NotNestedError(
            f"{labels[0]} and {labels[1]} differ in their noise, constraints or weights too", True
        )
    if not terms:
        raise NotNestedError(f"every free parameter of {labels[1]} is free in {labels[0]}")
    return _embedding(small, large, labels, terms, sources, {**values, **deviations})


def _deviations(small: Fit, large: Fit) -> dict[str, float]:
    """Return the deviations of sensors, parameters beside process noise alone, that the smaller fit estimates along."""
    found = {}
    for a, b in zip(small.parts, large.parts, strict=True):
        if (
            isinstance(a, FittedRecord)
            and isinstance(b, FittedRecord)
            and b.driven
            and not a.driven
        ):
            sizes = dict(zip(a.outputs, np.sqrt(np.diag(a.noise)).tolist(), strict=True))
            found |= {b.rename.get(f"v_{name}", f"v_{name}"): size for name, size in sizes.items()}
    return {name: size for name, size in found.items() if name in large.free}


# --- names


@dataclass(frozen=True, eq=False)
class _Slots:
    """The parameters of every part of two fits by their names inside, with their names outside.

    `models` are those of the parts of both; None where they are not at hand, as they need not be
    where both fits have the same.
    """

    small: tuple[Mapping[str, str], ...]
    large: tuple[Mapping[str, str], ...]
    models: tuple[tuple[Model, Model], ...] | None
    same_models: bool

    @classmethod
    def of(cls, small: Fit, large: Fit) -> "_Slots":
        pairs = list(zip(small.parts, large.parts, strict=True))
        same = all(a.model == b.model for a, b in pairs)
        of_small, of_large = _models(small), _models(large)
        if of_small is None or of_large is None:
            if not (same and all(a.rename == b.rename for a, b in pairs)):
                raise NotNestedError(
                    "their models are not available: give them to gb.load, models=[...]",
                    # Of other names than the larger one has they are two models, as far as names
                    # can say.
                    undecided=set(small.free) <= set(large.estimate),
                )
            # Without the models it is not known which part has which parameter; they are the same
            # in both fits.
            one, other = ({name: name for name in fit.estimate} for fit in (small, large))
            return cls((one,), (other,), None, same_models=True)
        return cls(
            tuple(_outside(part, model) for part, model in zip(small.parts, of_small, strict=True)),
            tuple(_outside(part, model) for part, model in zip(large.parts, of_large, strict=True)),
            tuple(zip(of_small, of_large, strict=True)),
            same_models=same,
        )


def _models(fit: Fit) -> tuple[Model, ...] | None:
    if fit.models:
        return fit.models
    try:
        return tuple(resolve(part.model, fit.given) for part in fit.parts)
    except LookupError:
        return None


def _outside(part: FittedPart, model: Model) -> dict[str, str]:
    """Return the names outside of the parameters of the model and of the criterion, by their names inside."""
    names = list(model.parameters)
    if isinstance(part, FittedRecord):
        names += part.added
    return {name: part.rename.get(name, name) for name in names}


def _require_same_assumptions(small: Fit, large: Fit, labels: tuple[str, str]) -> None:
    """Refuse fits that are two different models whatever their parameters.

    Biases and gains, which a criterion adds, are parameters that are zero where they are absent.
    """
    both = f"{labels[0]} and {labels[1]}"
    for a, b in zip(small.parts, large.parts, strict=True):
        shipped = isinstance(a, FittedRecord) and {a.criterion_class, b.criterion_class} <= SHIPPED
        if a.criterion_class != b.criterion_class and not shipped:
            raise NotNestedError(f"{both} have different criteria")
        if a.delay != b.delay:
            raise NotNestedError(f"{both} evaluate delays differently")
        if (
            isinstance(a, FittedResponse)
            and isinstance(b, FittedResponse)
            and (dict(a.at), a.sine) != (dict(b.at), b.sine)
        ):
            raise NotNestedError(f"{both} have different operating points")
        if (
            isinstance(a, FittedSpectrum)
            and isinstance(b, FittedSpectrum)
            and dict(a.at) != dict(b.at)
        ):
            raise NotNestedError(f"{both} have different operating points")
        if isinstance(a, FittedRecord) and isinstance(b, FittedRecord):
            if a.inputs != b.inputs:
                raise NotNestedError(f"the inputs of {both} run differently between samples")
            _require_fewer_terms(a, b, labels)


def _require_fewer_terms(small: FittedRecord, large: FittedRecord, labels: tuple[str, str]) -> None:
    """Refuse what a criterion adds to the smaller fit and not to the larger one."""
    if small.gains and bool(small.driven) != bool(large.driven):
        both = f"{labels[0]} and {labels[1]}"
        raise NotNestedError(
            f"the gains of {both} are free in one and follow from process noise in the other"
        )
    fewer = (
        set(small.driven) <= set(large.driven)
        if large.driven
        else set(small.gains) <= set(large.gains)
    )
    if not (fewer and set(small.biases) <= set(large.biases)):
        kind = "process noise" if small.driven else "gains"
        raise NotNestedError(f"{labels[0]} has {kind} or biases that {labels[1]} has not")


def _same_noise(small: Fit, large: Fit) -> bool:
    """Tell whether the fits differ in their parameters alone: not in constraints, weights, or what is said of noise."""
    for a, b in zip(small.parts, large.parts, strict=True):
        settings = [
            {
                k: v
                for k, v in part.settings.items()
                if k not in ("biases", "corrected", "process_noise")
            }
            for part in (a, b)
        ]
        if (
            settings[0] != settings[1]
            or a.weight != b.weight
            or sorted(a.constraints) != sorted(b.constraints)
        ):
            return False
    return True


def _sources(
    slots: _Slots, small: Fit, large: Fit, labels: tuple[str, str]
) -> dict[str, str | None]:
    """Return for every free parameter of the larger fit its counterpart in the smaller one, None where it has none."""
    of_small, of_large = (
        {q.name: q for q in fit.quantities if q.kind != "derived"} for fit in (small, large)
    )
    sources: dict[str, str | None] = {}
    for a, b in zip(slots.small, slots.large, strict=True):
        for inside, name in b.items():
            counterpart = a.get(inside)
            if of_large[name].kind == "free":
                if sources.setdefault(name, counterpart) != counterpart:
                    raise NotNestedError(
                        f"{name} of {labels[1]} stands for different parameters of {labels[0]} "
                        f"({', '.join(sorted(str(n) for n in (sources[name], counterpart)))})"
                    )
            elif counterpart is not None and not _held_alike(
                of_small[counterpart], of_large[name], small, large
            ):
                raise NotNestedError(
                    f"{labels[1]} holds {name} {of_large[name].kind} and {labels[0]} has {counterpart} "
                    f"{of_small[counterpart].kind}"
                )
    return {name: sources[name] for name in large.free}


def _held_alike(small: Quantity, large: Quantity, small_fit: Fit, large_fit: Fit) -> bool:
    """Tell whether a parameter that the larger fit holds fixed or tied is held so in the smaller one."""
    if large.kind == "fixed":
        return small.kind == "fixed" and math.isclose(
            small.value, large.value, rel_tol=EQUAL, abs_tol=0.0
        )
    ties = [[part.tied for part in fit.parts] for fit in (small_fit, large_fit)]
    return small.kind == "tied" and ties[0] == ties[1]


# --- formulas


def _removed(
    slots: _Slots,
    small: Fit,
    large: Fit,
    labels: tuple[str, str],
    absent: tuple[str, ...],
    stated: Mapping[str, float],
    removed_at: Mapping[str, float],
) -> dict[str, float]:
    """Return the values at which the absent parameters leave the larger model as the smaller one.

    `stated` are the values that the smaller one gives to other terms. Absent parameters of a
    criterion (biases and gains) are zero. Terms that have no effect there are found too: with them
    no test of nested models has its size (Davies 1977, Biometrika 64).
    """
    unknown = [name for name in absent if name in removed_at]
    values = {name: float(removed_at[name]) for name in unknown}
    of_model = [name for name in absent if name not in values and _is_of_model(slots, name)]
    values |= {name: 0.0 for name in absent if name not in values and name not in of_model}
    if slots.models is None or (unknown and not of_model):
        return values

    equations = _Equations(slots, small, large)
    if of_model and not equations.comparable:
        raise NotNestedError(
            f"the equations of {labels[0]} and {labels[1]} have different forms; if one is the other with "
            f"{listed(of_model)} removed, state at which values, removed_at={{name: value}}",
            undecided=True,
        )
    if not (slots.same_models and not of_model):
        found = _neutral(equations, values, of_model, large)
        if found is None:
            if not of_model:
                raise NotNestedError(f"{labels[1]} has other equations than {labels[0]}")
            tried = listed([f"{value:g}" for value in NEUTRAL])
            raise NotNestedError(
                f"{labels[1]} is not {labels[0]} where {listed(of_model)} {'is' if len(of_model) == 1 else 'are'} "
                f"{tried.replace(' and ', ' or ')}"
            )
        values, idle = found
        if idle:
            raise _idle(idle, [name for name in of_model if name not in idle], labels)

    terms = [name for name in (*values, *stated) if _is_of_model(slots, name)]
    idle = [
        name for name in terms if len(terms) > 1 and equations.is_idle(name, {**values, **stated})
    ]
    if idle:
        raise _idle(idle, [name for name in terms if name not in idle], labels)
    return values


def _is_of_model(slots: _Slots, name: str) -> bool:
    if slots.models is None:
        return False
    return any(
        outside == name and inside in model.parameters
        for part, (_, model) in zip(slots.large, slots.models, strict=True)
        for inside, outside in part.items()
    )


def _idle(idle: Sequence[str], rest: Sequence[str], labels: tuple[str, str]) -> NotNestedError:
    return NotNestedError(
        f"{listed(idle)} of {labels[1]} {'has' if len(idle) == 1 else 'have'} no effect where "
        f"{listed(rest) if rest else 'the rest'} is as in {labels[0]}, and a nested test then lacks its nominal size; "
        f"fix {listed(idle)} at a value known beforehand to test {listed(rest) if rest else 'the rest'}",
        undecided=True,
    )


def _neutral(
    equations: "_Equations", known: Mapping[str, float], names: Sequence[str], large: Fit
) -> tuple[dict[str, float], tuple[str, ...]] | None:
    """Return values of `names` with which the larger model is the smaller one, and those which may have any value."""
    if len(names) <= MOST_COMBINED:
        combinations: Iterator[tuple[float, ...]] = itertools.product(NEUTRAL, repeat=len(names))
    else:
        combinations = iter([(value,) * len(names) for value in NEUTRAL])
    for combination in combinations:
        values = {**known, **dict(zip(names, combination, strict=True))}
        if equations.agree(values):
            return values, ()
    for name in names if len(names) > 1 else ():
        others = tuple(other for other in names if other != name)
        for value in NEUTRAL:
            values = {**known, **{other: large.estimate[other] for other in others}, name: value}
            if equations.agree(values):
                return values, others
    return None


class _Equations:
    """The formulas of two fits at random points, the same for both."""

    def __init__(self, slots: _Slots, small: Fit, large: Fit) -> None:
        assert slots.models is not None
        self._slots = slots
        self._small = small
        self._large = large
        self._bounds = {q.name: q.bounds for q in small.quantities}
        self._kinds = {q.name: q.kind for q in small.quantities}

    @property
    def comparable(self) -> bool:
        """True when the models in time are two transfer functions, or two `StateSpace`."""
        assert self._slots.models is not None
        pairs = zip(self._slots.models, self._large.parts, strict=True)
        return all(
            isinstance(part, FittedResponse)
            or isinstance(a, StateSpace) == isinstance(b, StateSpace)
            for (a, b), part in pairs
        )

    def agree(self, values: Mapping[str, float]) -> bool:
        """Tell whether the larger model with these values has the smaller one's equations."""
        return all(self._part_agrees(k, values) for k in range(len(self._slots.small)))

    def is_idle(self, name: str, values: Mapping[str, float]) -> bool:
        """Tell whether the larger model does not depend on one of its parameters where others have these values."""
        moved = self._large.estimate[name]
        if math.isclose(moved, values[name], rel_tol=1e-3, abs_tol=1e-12):
            moved = values[name] + 0.1 * max(abs(values[name]), 1.0)
        other = {**values, name: moved}
        return all(self._part_agrees(k, other, values) for k in range(len(self._slots.small)))

    def _part_agrees(
        self, k: int, values: Mapping[str, float], instead: Mapping[str, float] | None = None
    ) -> bool:
        """Compare a part of the larger fit with that of the smaller one, or with itself at other values."""
        assert self._slots.models is not None
        small, large = self._slots.models[k]
        names = self._slots.large[k]
        reference = small if instead is None else large

        def pair(drawn: Mapping[str, float]) -> tuple[dict[str, float], dict[str, float]]:
            one = self._of_large(large, names, drawn, values)
            other = self._of_large(large, names, drawn, instead) if instead is not None else None
            return one, other or {n: drawn[n] for n in small.parameters}

        random = np.random.default_rng(0)
        draw = lambda: self._draw(k, random)  # noqa: E731  (one line, used by three comparisons)
        part = self._large.parts[k]
        if isinstance(part, FittedResponse):
            return _same_responses(large, reference, part, draw, pair)
        if isinstance(large, TransferFunction) and isinstance(reference, TransferFunction):
            return _same_transfer_functions(large, reference, draw, pair, random)
        if isinstance(large, StateSpace) and isinstance(reference, StateSpace):
            order = delay_order(part.delay)
            return _same_dynamics(
                dynamics(large, order), dynamics(reference, order), draw, pair, random
            )
        return False

    def _of_large(
        self,
        model: Model,
        names: Mapping[str, str],
        drawn: Mapping[str, float],
        values: Mapping[str, float],
    ) -> dict[str, float]:
        """Return the larger model's parameters: those in `values` by outside name, those drawn, and its own."""
        return {
            inside: values.get(
                names[inside], drawn.get(inside, self._large.estimate[names[inside]])
            )
            for inside in model.parameters
        }

    def _draw(self, k: int, random: np.random.Generator) -> dict[str, float]:
        """Return values of the smaller model's parameters by inside name: about its estimate, the fixed ones as are."""
        drawn = {}
        for inside, name in self._slots.small[k].items():
            value = self._small.estimate[name]
            if self._kinds[name] != "fixed":
                low, high = self._bounds[name]
                moved = value + PARAMETER_SPREAD * (abs(value) or 1.0) * random.normal()
                value = float(
                    np.clip(moved, *((low, high) if low < high else (-math.inf, math.inf)))
                )
            drawn[inside] = value
        return drawn


_Draw = Callable[[], dict[str, float]]
_Pair = Callable[[Mapping[str, float]], tuple[dict[str, float], dict[str, float]]]


def _same_dynamics(
    large: Dynamics, small: Dynamics, draw: _Draw, pair: _Pair, random: np.random.Generator
) -> bool:
    """Compare right-hand sides, outputs and delays; states that the larger one has more must have no effect."""
    if not (set(small.inputs) <= set(large.inputs) and set(small.states) <= set(large.states)):
        return False
    shared = [name for name in small.outputs if name in large.outputs]
    rows = [large.states.index(name) for name in small.states]
    columns = [large.inputs.index(name) for name in small.inputs]
    finite = 0
    for _ in range(POINTS):
        p, q = pair(draw())
        x = _decades(random, len(large.states))
        u = _decades(random, len(large.inputs))
        one = [p[name] for name in large.parameters]
        other = [q[name] for name in small.parameters]
        values = (
            (
                _vector(large.derivative, x, u, one)[rows],
                _vector(small.derivative, x[rows], u[columns], other),
            ),
            (
                _vector(large.output, x, u, one)[[large.outputs.index(n) for n in shared]],
                _vector(small.output, x[rows], u[columns], other)[
                    [small.outputs.index(n) for n in shared]
                ],
            ),
            (_vector(large.delay, one)[columns], _vector(small.delay, other)),
        )
        if not all(_same(a, b, SAME) for a, b in values):
            return False
        finite += all(np.all(np.isfinite(a)) for a, _ in values)
    return bool(shared) and finite >= FEWEST_FINITE


def _decades(random: np.random.Generator, count: int) -> Array:
    """Draw values of either sign whose sizes are spread over decades."""
    return random.choice([-1.0, 1.0], count) * 10 ** random.uniform(*DECADES, count)


def _vector(function: Callable[..., object], *arguments: object) -> Array:
    return np.asarray(function(*arguments), dtype=float).ravel()


def _same_transfer_functions(
    large: TransferFunction,
    small: TransferFunction,
    draw: _Draw,
    pair: _Pair,
    random: np.random.Generator,
) -> bool:
    finite = 0
    for _ in range(POINTS):
        p, q = pair(draw())
        s = np.array([10 ** random.uniform(*DECADES) * np.exp(1j * random.uniform(0, np.pi / 2))])
        with np.errstate(all="ignore"):
            one, other = (
                np.asarray(m.response(s, m.values(v)) + 0 * s) for m, v in ((large, p), (small, q))
            )
        if not _same(one, other, SAME):
            return False
        finite += bool(np.all(np.isfinite(one)))
    return finite >= FEWEST_FINITE


def _same_responses(
    large: Model, small: Model, part: FittedResponse, draw: _Draw, pair: _Pair
) -> bool:
    """Compare responses at some of the data's frequencies, about the operating point that both are fitted at."""
    omega = part.data.omega[:: max(len(part.data) // FREQUENCIES, 1)]
    signals = {
        "input": part.data.input,
        "output": part.data.output,
        "at": part.at,
        "delay": part.delay,
    }
    finite = 0
    for _ in range(VECTORS):
        try:
            one, other = (
                response_of_test(
                    model, values, omega, part.sine, part.data.omega, **signals
                ).response
                for model, values in zip((large, small), pair(draw()), strict=True)
            )
        except ValueError:  # no operating point, or no value, at this draw
            continue
        if not _same(one, other, SAME_RESPONSE):
            return False
        finite += 1
    return finite >= FEWEST_FINITE


def _same(one: NDArray[np.inexact], other: NDArray[np.inexact], tolerance: float) -> bool:
    """Tell whether two vectors are equal; where one is not finite the other must not be either."""
    finite = np.isfinite(one)
    if not np.array_equal(finite, np.isfinite(other)):
        return False
    sizes = np.maximum(np.abs(one[finite]), np.abs(other[finite]))
    rounding = ROUNDING * np.max(sizes, initial=0.0)
    return bool(
        np.all(np.abs(one[finite] - other[finite]) <= np.maximum(tolerance * sizes, rounding))
    )


# --- the smaller model's place within the larger one


def _embedding(
    small: Fit,
    large: Fit,
    labels: tuple[str, str],
    terms: tuple[str, ...],
    sources: Mapping[str, str | None],
    values: Mapping[str, float],
) -> Nesting:
    """Return where the smaller model lies, and the directions that leave it, by the derivatives of its place."""
    slope = np.zeros((len(large.free), len(small.free)))
    point = np.zeros(len(large.free))
    kinds = {q.name: q.kind for q in small.quantities}
    for i, name in enumerate(large.free):
        source = sources[name]
        point[i] = values[name] if source is None else small.estimate[source]
        if source in small.free:
            slope[i, small.free.index(source)] = 1.0
        elif source is not None and kinds[source] == "tied":
            slope[i] = _slope_of_tie(small, source)
    along = [i for i, name in enumerate(large.free) if name not in terms and sources[name] is None]
    slope = np.hstack([slope, np.eye(len(large.free))[:, along]])

    free = {q.name: q for q in large.quantities if q.kind == "free"}
    beyond = [
        n for n, v in zip(large.free, point, strict=True) if n in terms and _beyond(free[n], v)
    ]
    if beyond:
        places = {name: point[large.free.index(name)] for name in beyond}
        stated = listed([f"{name} = {value:g}" for name, value in places.items()])
        low, high = free[beyond[0]].bounds
        raise NotNestedError(
            f"{stated}, as in {labels[0]}, is outside the bounds ({low:g}, {high:g}) of {labels[1]}"
        )
    if not np.all(np.isfinite(slope)):
        raise NotNestedError(
            f"the data do not determine what {labels[0]} ties to others", undecided=True
        )

    directions = _left_null_space(slope, point)
    more = _initial_states(large) + len(along) - _initial_states(small)
    if more < 0 or not directions.shape[1]:
        fewer = counted(-more, "initial state") if more < 0 else "no parameter"
        raise NotNestedError(
            f"{labels[1]} has {fewer} {'less' if more < 0 else 'more'} than {labels[0]}"
        )
    on_bound = tuple(n for n in terms if _on_bound(free[n], point[large.free.index(n)]))
    return Nesting(terms, point, directions, on_bound, more)


def _slope_of_tie(fit: Fit, name: str) -> Array:
    """Return the derivatives (p,) of a tied value by the free parameters, from its covariance with them."""
    both = fit.covariance_of([*fit.free, name])
    root = np.sqrt(np.diag(both)[:-1])
    size = np.where(root > 0, root, 1.0)
    if not np.all(np.isfinite(both)):
        return np.full(len(fit.free), np.nan)
    slope, *_ = np.linalg.lstsq(
        both[:-1, :-1] / np.outer(size, size), both[:-1, -1] / size, rcond=None
    )
    return np.where(root > 0, slope / size, 0.0)


def _left_null_space(slope: Array, point: Array) -> Array:
    """Return the directions (p, r) on which the smaller model's free parameters have no effect."""
    size = np.where(point != 0, np.abs(point), 1.0)
    scaled = slope / size[:, None]
    length = np.linalg.norm(scaled, axis=0)
    scaled = scaled / np.where(length > 0, length, 1.0)
    left, singular, _ = np.linalg.svd(scaled)
    rank = int(np.sum(singular > RANK * max(float(singular.max(initial=0.0)), 1e-300)))
    return left[:, rank:] / size[:, None]


def _initial_states(fit: Fit) -> int:
    """Return how many initial states were estimated, and numbers of the noise, of which nested fits have as many."""
    return sum(part.nuisances for part in fit.parts)


def _beyond(quantity: Quantity, value: float) -> bool:
    low, high = quantity.bounds
    tolerance = EQUAL * max(abs(value), 1e-300)
    return not low - tolerance <= value <= high + tolerance


def _on_bound(quantity: Quantity, value: float) -> bool:
    return any(
        math.isclose(value, bound, rel_tol=EQUAL, abs_tol=1e-300) for bound in quantity.bounds
    )
