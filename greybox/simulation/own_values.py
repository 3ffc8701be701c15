"""Values of a record's own, estimated from a record that the model was not fitted to: biases, trims.

A bias of a sensor, and a parameter of the trim, belong to a record and not to the model: on another
record they have other values, which its own samples tell. They are those that predict its windows
best, by Gauss-Newton steps on the samples of all windows at once, with every window's first state
an unknown of its own about a mean that the windows share, and with the model's parameters held.
Source: Tischler and Remple (2012), Aircraft and Rotorcraft System Identification, 2nd ed., section
14.4: verification with biases and reference shifts estimated anew.
"""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.compiled.sampled_data import gapless
from greybox.files.arrays import Array, IntArray
from greybox.files.text_table import counted, listed, with_error
from greybox.formulation.time_criteria import WIDEST_BIAS
from greybox.modeling.integrators import Integrator
from greybox.modeling.model import require_known
from greybox.simulation.model_at_estimate import ModelAtEstimate
from greybox.simulation.simulator import Simulator, WindowLinearization
from greybox.simulation.windows import Windows, cut

ITERATIONS = 15  # of Gauss-Newton: biases and trims are nearly linear, and settle in two or three
SETTLED = 1e-2  # of a standard error: a step that does not matter
HALVINGS = 8  # of a step that is not finite or predicts worse
WORSE = 1e-6  # relative growth of the squares that is rounding
# Times by which windows are made longer, and by which their mean square may grow over that of the
# shorter ones, or the noise, for a free simulation to follow the record still: a tenth more in rms
# is due to slow errors of the model.
LENGTHENED = 4
LARGER_SQUARES = 1.2
# Relative eigenvalue of the information below which a direction is not determined.
BLIND = 1e-9
# Of a direction that is not determined: the least share of a value that takes part in it.
TAKES_PART = 1e-2


@dataclass(frozen=True, eq=False)
class OwnValues:
    """What a record tells of values of its own.

    Attributes
    ----------
    names : tuple of str
        Of those that were estimated.
    values, errors : (a,) arrays
        With their standard errors, which include those of the model's parameters.
    units : tuple of str
    kept : tuple of str
        Names of those that the record does not determine.
    numbers : int
        How many measured numbers they were estimated from.
    """

    names: tuple[str, ...]
    values: Array
    errors: Array
    units: tuple[str, ...]
    kept: tuple[str, ...]
    numbers: int

    @property
    def by_name(self) -> dict[str, tuple[float, float]]:
        """Values and standard errors by name."""
        return {
            n: (float(v), float(e))
            for n, v, e in zip(self.names, self.values, self.errors, strict=True)
        }

    def notes(self, record: str) -> tuple[str, ...]:
        """Say what was estimated from the record, and what was not."""
        said = []
        if self.names:
            stated = []
            for name, value, error, unit in zip(
                self.names, self.values, self.errors, self.units, strict=True
            ):
                number, deviation = with_error(float(value), float(error))
                stated.append(
                    f"{name} = {number} ± {deviation} {'' if unit == '1' else unit}".rstrip()
                )
            values = counted(len(self.names), "value")
            said.append(
                f"{listed(stated)} {'was' if len(stated) == 1 else 'were'} estimated from {record} itself: {values} "
                f"from {counted(self.numbers, 'number')}, in which it is not held out."
            )
        if self.kept:
            said.append(
                f"{listed(self.kept)}: not determined by {record}, the value of the fit is kept."
            )
        return tuple(said)


def with_own_values(
    model: ModelAtEstimate,
    windows: Windows,
    outputs: tuple[str, ...],
    integrator: Integrator,
    own: Sequence[str],
) -> tuple[ModelAtEstimate, OwnValues | None]:
    """Return the model with the values `own` estimated from the windows, and these; None where there are none.

    Raises
    ------
    ValueError
        For a name that the model does not have, or of a bias whose signal it does not have.
    """
    if not own:
        return model, None
    model = _with_biases(model, own)
    names = tuple(dict.fromkeys(own))
    simulator = Simulator(model, model.criterion, outputs, integrator)
    found = _determined(simulator, model, windows, names)
    for longer in _longer(model, windows, outputs):
        candidate = _determined(simulator, found.model, longer, names)
        if not candidate.follows_noise_as(found):
            break
        if candidate.is_more_certain_than(found):
            found = candidate

    kept = tuple(name for name in names if name not in found.names)
    if not found.names:
        return model, OwnValues((), np.zeros(0), np.zeros(0), (), kept, 0)
    solved = replace(found.model, covariance=_covariance(simulator, found))
    assert solved.covariance is not None
    errors = np.sqrt(np.diag(solved.covariance)[found.places])
    units = tuple(_unit(model, windows, name) for name in found.names)
    rows = np.unique(found.windows.rows)
    numbers = sum(int(np.isfinite(windows.record[name][rows]).sum()) for name in outputs)
    return solved, OwnValues(found.names, solved.q[found.places], errors, units, kept, numbers)


@dataclass(frozen=True, eq=False)
class _Found:
    """The values that windows of one length determine, and the information there; None where there are none."""

    model: ModelAtEstimate
    windows: Windows
    names: tuple[str, ...]
    information: "_Information | None"

    @property
    def places(self) -> IntArray:
        return np.array([self.model.names.index(name) for name in self.names], dtype=int)

    def errors(self) -> Array:
        assert self.information is not None
        return np.sqrt(
            np.diag(_pseudo_inverse(self.information.matrix)) * _inflation(self.information)
        )

    def follows_noise_as(self, shorter: "_Found") -> bool:
        """Tell whether the errors over these windows are hardly larger than over shorter ones."""
        if self.information is None:
            return False
        if shorter.information is None:
            return True
        squares, before = (i.squares / i.numbers for i in (self.information, shorter.information))
        return squares <= LARGER_SQUARES * max(before, 1.0)

    def is_more_certain_than(self, other: "_Found") -> bool:
        """Tell whether more values are determined, or the same by smaller errors."""
        if self.names != other.names:
            return len(self.names) > len(other.names)
        return bool(self.names) and float(np.sum(np.log(self.errors() / other.errors()))) < 0.0


def _longer(
    model: ModelAtEstimate, windows: Windows, outputs: tuple[str, ...]
) -> Iterator[Windows]:
    """Yield windows of the same record that are longer and longer, as long as there are any.

    What is constant shows the better the longer a simulation runs free, while that follows the
    record.
    """
    record = windows.record
    inputs = model.system.inputs
    if not record.has_time:
        return
    most = max(len(stretch) for stretch in gapless(record, inputs, outputs)) - windows.lead
    horizon = windows.horizon
    while horizon < most:
        horizon = min(LENGTHENED * horizon, most)
        with contextlib.suppress(ValueError):  # nothing measured in them
            yield cut(
                record,
                inputs,
                outputs,
                lead=windows.lead * record.step,
                horizon=horizon * record.step,
            )


def _determined(
    simulator: Simulator, model: ModelAtEstimate, windows: Windows, own: Sequence[str]
) -> _Found:
    """Estimate those of the values `own` that the windows determine; the others stay as they are."""
    limits = {name: _limits(model, windows, name) for name in own}
    names = list(own)
    while names:
        places = np.array([model.names.index(name) for name in names])
        found = _minimized(simulator, model, windows, places, [limits[name] for name in names])
        if found is None:
            break
        solved, information = found
        lost = _not_determined(information, names, limits)
        if not lost:
            return _Found(solved, windows, tuple(names), information)
        names.remove(lost)
    return _Found(model, windows, (), None)


def _with_biases(model: ModelAtEstimate, own: Sequence[str]) -> ModelAtEstimate:
    """Return the model with a bias of zero for every signal that has none yet and is to have one."""
    possible = {f"{signal}_bias" for signal in (*model.system.outputs, *model.system.inputs)}
    new = [name for name in own if name not in model.names and name in possible]
    require_known(own, (*model.names, *new), "parameter", model.label)
    if not new:
        return model
    biases = (*model.criterion.biases, *(name.removesuffix("_bias") for name in new))
    covariance = model.covariance
    if covariance is not None:
        covariance = np.pad(covariance, ((0, len(new)), (0, len(new))))
    return replace(
        model,
        names=(*model.names, *new),
        q=np.append(model.q, np.zeros(len(new))),
        covariance=covariance,
        criterion=replace(model.criterion, biases=biases),
    )


def _limits(model: ModelAtEstimate, windows: Windows, name: str) -> tuple[float, float]:
    """Return the bounds of a value: those declared, or of a bias so many ranges of its signal in the record."""
    if name in model.declared:
        return model.declared[name].bounds
    signal = windows.record.signals.get(name.removesuffix("_bias"))
    if signal is None or not np.isfinite(signal).any():
        return -np.inf, np.inf
    span = WIDEST_BIAS * (float(np.nanmax(signal) - np.nanmin(signal)) or 1.0)
    return -span, span


def _unit(model: ModelAtEstimate, windows: Windows, name: str) -> str:
    if name in model.declared:
        return model.declared[name].unit
    return windows.record.units.get(name.removesuffix("_bias"), "")


@dataclass(frozen=True, eq=False)
class _Information:
    """The normal equations of the active values, states and their mean eliminated.

    `matrix` (a, a) and `gradient` (a,); `squares` of the weighted residuals that remain, of so many
    `numbers`; `overlap` says how often a number was used on average.
    """

    matrix: Array
    gradient: Array
    squares: float
    numbers: int
    overlap: float


def _minimized(
    simulator: Simulator,
    model: ModelAtEstimate,
    windows: Windows,
    places: IntArray,
    limits: Sequence[tuple[float, float]],
) -> tuple[ModelAtEstimate, _Information] | None:
    """Return the model at the best values of `places`, with the information there; None where nothing is finite."""
    low, high = np.array(limits).T

    def at(q: Array) -> _Information:
        return _information(simulator.at(q), windows, places)

    q = model.q.copy()
    q[places] = np.clip(q[places], low, high)
    now = at(q)
    if not now.numbers:
        return None
    for _ in range(ITERATIONS):
        step = _solved(now.matrix, now.gradient)
        q, after, taken = _searched(at, q, now, places, step, (low, high))
        size = np.sqrt(np.maximum(np.diag(_pseudo_inverse(now.matrix)), 0.0))
        now = after
        if np.all(np.abs(taken) <= SETTLED * size):
            break
    return replace(model, q=q), now


def _searched(
    at: Callable[[Array], _Information],
    q: Array,
    now: _Information,
    places: IntArray,
    step: Array,
    limits: tuple[Array, Array],
) -> tuple[Array, _Information, Array]:
    """Take a step, halved until the mean square does not grow; returns values, information, and what was taken."""
    before = now.squares / now.numbers
    for _ in range(HALVINGS):
        moved = q.copy()
        moved[places] = np.clip(q[places] + step, *limits)
        after = at(moved)
        if after.numbers >= now.numbers and after.squares / after.numbers <= before * (1 + WORSE):
            return moved, after, moved[places] - q[places]
        step = step / 2
    return q, now, np.zeros(len(places))


def _information(simulator: Simulator, windows: Windows, places: IntArray) -> _Information:
    """Return the normal equations at the simulator's values.

    The first state of a window is a mean of all windows, which is not known, and a deviation with
    the prior's spread.
    """
    made = simulator.linearize_windows(windows, places)
    n = made.initial.states.shape[1]
    J, r = _weighted(made)
    by_state = J[..., :n]
    columns = np.concatenate([J[..., n:], by_state], axis=2)  # values, and the mean of the states

    usable = np.any(made.used, axis=(1, 2))
    precision = np.nan_to_num(made.initial.precision)
    deviation = np.where(
        usable[:, None], made.initial.states - np.nan_to_num(made.initial.mean), 0.0
    )
    H = by_state.transpose(0, 2, 1) @ by_state + np.diag(precision)
    slope = np.einsum("wmn,wm->wn", by_state, r) - precision * deviation
    cross = columns.transpose(0, 2, 1) @ by_state
    solved = (
        np.linalg.solve(H, np.concatenate([cross.transpose(0, 2, 1), slope[..., None]], axis=2))
        if n
        else None
    )
    matrix = np.einsum("wma,wmb->ab", columns, columns)
    gradient = np.einsum("wma,wm->a", columns, r)
    squares = float(np.sum(r**2))
    if solved is not None:
        matrix = matrix - np.einsum("wan,wnb->ab", cross, solved[..., :-1])
        gradient = gradient - np.einsum("wan,wn->a", cross, solved[..., -1])
        squares += float(np.sum(precision * deviation**2)) - float(
            np.einsum("wn,wn->", slope, solved[..., -1])
        )

    a = len(places)
    mean = _pseudo_inverse(matrix[a:, a:])
    gain = matrix[:a, a:] @ mean
    squares -= float(gradient[a:] @ mean @ gradient[a:])
    share = windows.horizon / (windows.lead + windows.horizon)
    numbers = int(made.used.sum())
    return _Information(
        matrix[:a, :a] - gain @ matrix[a:, :a],
        gradient[:a] - gain @ gradient[a:],
        squares,
        numbers,
        1 / share,
    )


def _weighted(made: WindowLinearization) -> tuple[Array, Array]:
    """Return slopes (w, m, n + a) and residuals (w, m) in units of the noise."""
    weight = np.linalg.inv(np.linalg.cholesky(made.initial.noise))
    w = len(made.residuals)
    J = np.einsum("ij,wtjv->wtiv", weight, made.slopes).reshape(w, -1, made.slopes.shape[-1])
    return J, np.einsum("ij,wtj->wti", weight, made.residuals).reshape(w, -1)


def _scales(matrix: Array) -> Array:
    diagonal = np.diag(matrix)
    return np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)


def _eigen(matrix: Array) -> tuple[Array, Array, Array]:
    """Return eigenvalues and vectors of the matrix with a diagonal of ones, and the scales that make it so."""
    scale = _scales(matrix)
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    return values, vectors, scale


def _pseudo_inverse(matrix: Array) -> Array:
    if not len(matrix):
        return matrix
    values, vectors, scale = _eigen(matrix)
    kept = values > BLIND * max(float(values[-1]), 0.0)
    root = vectors[:, kept] / np.sqrt(values[kept])
    return (root @ root.T) * np.outer(scale, scale)


def _solved(matrix: Array, gradient: Array) -> Array:
    return _pseudo_inverse(matrix) @ gradient


def _not_determined(
    information: _Information, names: Sequence[str], limits: Mapping[str, tuple[float, float]]
) -> str:
    """Return the value that the record determines least, where it does not determine it; empty otherwise.

    Because the samples do not change with it, or because its error is larger than half of its
    bounds.
    """
    values, vectors, scale = _eigen(information.matrix)
    blind = np.flatnonzero(values <= BLIND * max(float(values[-1]), 0.0))
    if blind.size:
        share = np.where(scale > 0, np.max(np.abs(vectors[:, blind]), axis=1), 2.0)
        if np.max(share) > TAKES_PART:
            return names[int(np.argmax(share))]
    error = np.sqrt(np.diag(_pseudo_inverse(information.matrix)) * _inflation(information))
    half = np.array([0.5 * (limits[name][1] - limits[name][0]) for name in names])
    ratio = np.where(np.isfinite(half), error / half, 0.0)
    return names[int(np.argmax(ratio))] if ratio.max() > 1 else ""


def _inflation(information: _Information) -> float:
    """Return by how much the variance is larger than that of noise as the fit had it, each number used once."""
    return information.overlap * max(information.squares / max(information.numbers, 1), 1.0)


def _covariance(simulator: Simulator, found: _Found) -> Array:
    """Return the covariance (declared, declared) with that of the own values, which follow the model's parameters."""
    model = found.model
    places = found.places
    assert found.information is not None
    whole = (
        np.zeros((len(model.names),) * 2) if model.covariance is None else model.covariance.copy()
    )
    whole[places] = 0.0
    whole[:, places] = 0.0
    others = np.flatnonzero(np.isfinite(np.diag(whole)) & (np.diag(whole) > 0))
    a = len(places)
    both = _information(
        simulator.at(model.q), found.windows, np.concatenate([places, others])
    ).matrix
    inverse = _pseudo_inverse(found.information.matrix)
    follow = -inverse @ both[:a, a:]  # of the own values by the model's parameters
    shared = whole[np.ix_(others, others)]
    whole[np.ix_(places, others)] = follow @ shared
    whole[np.ix_(others, places)] = (follow @ shared).T
    whole[np.ix_(places, places)] = (
        inverse * _inflation(found.information) + follow @ shared @ follow.T
    )
    return whole
