"""Estimates biases and trims of a record to which the model was not fitted.

The bias of a sensor and a trim parameter belong to a record, not to the model. On another record
they have other values: those that predict its windows best. Gauss-Newton steps on the samples of
all windows find them. The model's parameters are held, and the first state of every window is an
unknown about a mean that the windows share.
Source: Tischler and Remple (2012), Aircraft and Rotorcraft System Identification, 2nd ed., section
14.4: verification with biases and reference shifts estimated anew.
"""

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.compiled.sampled_data import gapless
from greybox.files.arrays import Array, IntArray
from greybox.files.text_table import counted, listed, with_error
from greybox.formulation.time_criteria import WIDEST_BIAS
from greybox.modeling.integrators import Integrator
from greybox.modeling.model import require_known
from greybox.simulation.model_at_estimate import ModelAtEstimate
from greybox.simulation.simulator import Simulator
from greybox.simulation.state_estimation import whitening
from greybox.simulation.windows import Windows, cut

BLIND = 1e-9  # relative eigenvalue of the information below which a direction is not determined


@dataclass(frozen=True, eq=False)
class OwnValues:
    """Values that belong to a record, estimated from it.

    Attributes
    ----------
    names : tuple of str
        Names of the estimated values.
    values, errors : (a,) arrays
        Their standard errors include those of the model's parameters.
    units : tuple of str
    undetermined : tuple of str
        Names of values that the record does not determine.
    numbers : int
        Number of measurements from which they were estimated.
    """

    names: tuple[str, ...]
    values: Array
    errors: Array
    units: tuple[str, ...]
    undetermined: tuple[str, ...]
    numbers: int

    @property
    def by_name(self) -> dict[str, tuple[float, float]]:
        """Values and standard errors by name."""
        pairs = zip(self.values.tolist(), self.errors.tolist(), strict=True)
        return dict(zip(self.names, pairs, strict=True))

    def notes(self, record: str) -> tuple[str, ...]:
        """Return sentences on the values that were estimated from the record, and on the others."""
        notes = []
        texts = []
        for (name, pair), unit in zip(self.by_name.items(), self.units, strict=True):
            number, deviation = with_error(*pair)
            texts.append(f"{name} = {number} ± {deviation} {'' if unit == '1' else unit}".rstrip())
        if texts:
            notes.append(
                f"{listed(texts)} {'was' if len(texts) == 1 else 'were'} estimated from {record} "
                f"itself: {counted(len(texts), 'value')} from {counted(self.numbers, 'number')}, "
                "so the record is not held out in them."
            )
        if self.undetermined:
            notes.append(
                f"{listed(self.undetermined)}: not determined by {record}, the value of the fit is "
                "used."
            )
        return tuple(notes)


def with_own_values(
    model: ModelAtEstimate,
    windows: Windows,
    outputs: tuple[str, ...],
    integrator: Integrator,
    own: Sequence[str],
) -> tuple[ModelAtEstimate, OwnValues | None]:
    """Return the model with the values `own` estimated from the windows, and these, if any.

    Raises
    ------
    ValueError
        If the model does not have a name, or the signal of a bias.
    """
    if not own:
        return model, None
    biased = _with_biases(model, own)
    names = tuple(dict.fromkeys(own))
    simulator = Simulator(biased, biased.criterion, outputs, integrator)

    # Short windows come first: they follow the record even with wrong values.
    solution = _determined(simulator, biased, windows, names)
    for longer in _longer(biased, windows, outputs):
        candidate = _determined(simulator, solution.model, longer, names)
        # Up to a tenth more in rms is due to slow errors of the model. With more, the free
        # simulation no longer follows the record.
        reference = solution.information.mean_square if solution.names else math.inf
        follows = candidate.information.mean_square <= 1.2 * max(reference, 1.0)
        if not candidate.names or not follows:
            break
        if candidate.certainty > solution.certainty:
            solution = candidate

    undetermined = tuple(name for name in names if name not in solution.names)
    if not solution.names:
        return model, OwnValues((), np.zeros(0), np.zeros(0), (), undetermined, 0)
    covariance = _covariance(simulator, solution)
    rows = np.unique(solution.windows.rows)
    values = OwnValues(
        names=solution.names,
        values=solution.model.q[solution.places],
        errors=np.sqrt(np.diag(covariance)[solution.places]),
        units=tuple(_unit(biased, windows, name) for name in solution.names),
        undetermined=undetermined,
        numbers=sum(int(np.isfinite(windows.record[name][rows]).sum()) for name in outputs),
    )
    return replace(solution.model, covariance=covariance), values


@dataclass(frozen=True, eq=False)
class _Solution:
    """The model with the values `names` that windows determine, and the information on them."""

    model: ModelAtEstimate
    windows: Windows
    names: tuple[str, ...]
    information: "_Information"

    @property
    def places(self) -> IntArray:
        return np.array([self.model.names.index(name) for name in self.names], dtype=int)

    @property
    def certainty(self) -> tuple[float, float]:
        """Number of determined values, and minus the sum of the logarithms of their variances."""
        variances = np.diag(self.information.covariance)
        return len(self.names), -float(np.sum(np.log(variances[: len(self.names)])))


def _longer(
    model: ModelAtEstimate, windows: Windows, outputs: tuple[str, ...]
) -> Iterator[Windows]:
    """Yield windows of the record four times as long, and so on to the longest stretch.

    The longer a free simulation is, the better it shows constant errors.
    """
    record = windows.record
    if not record.has_time:
        return

    # No window reaches across a gap, behind which the state is unknown.
    stretches = gapless(record, model.system.inputs, outputs)
    most = max(len(stretch) for stretch in stretches) - windows.lead
    lead = windows.lead * record.step
    horizon = windows.horizon
    while horizon < most:
        horizon = min(4 * horizon, most)
        with contextlib.suppress(ValueError):  # no outputs were measured in them
            duration = horizon * record.step
            yield cut(record, model.system.inputs, outputs, lead=lead, horizon=duration)


def _determined(
    simulator: Simulator, model: ModelAtEstimate, windows: Windows, own: Sequence[str]
) -> _Solution:
    """Estimate those of the values `own` that the windows determine; the others stay."""
    limits = {name: _limits(model, windows, name) for name in own}
    while True:
        places = np.array([model.names.index(name) for name in limits], dtype=int)
        solved, information = _minimized(simulator, model, windows, places, limits)

        # One at a time: without that value, the record may determine the others.
        lost = _not_determined(information, limits) if limits and information.numbers else ""
        if not lost:
            names = tuple(limits) if information.numbers else ()
            return _Solution(solved if names else model, windows, names, information)
        del limits[lost]


def _with_biases(model: ModelAtEstimate, own: Sequence[str]) -> ModelAtEstimate:
    """Return the model with a bias of zero for every signal in `own` that has none yet."""
    possible = {f"{signal}_bias" for signal in (*model.system.outputs, *model.system.inputs)}
    new = [name for name in dict.fromkeys(own) if name in possible and name not in model.names]
    require_known(own, (*model.names, *new), "parameter", model.label)
    if not new:
        return model
    biases = (*model.criterion.biases, *(name.removesuffix("_bias") for name in new))
    covariance = model.covariance

    # The fit had no such bias, hence no error of it: only the record estimates it.
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
    """Return the declared bounds; for a bias, a multiple of the range of its signal."""
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
    """Normal equations of the active values, with the states and their mean eliminated.

    `matrix` (a, a) and `gradient` (a,); `squares` is the sum of the remaining weighted residuals,
    `numbers` their count, `overlap` how often a measurement is used on average.
    """

    matrix: Array
    gradient: Array
    squares: float
    numbers: int
    overlap: float

    @property
    def mean_square(self) -> float:
        return self.squares / max(self.numbers, 1)

    @property
    def covariance(self) -> Array:
        """The covariance (a, a) by the noise of the fit, or by the residuals if they are larger."""
        return pseudo_inverse(self.matrix) * self.overlap * max(self.mean_square, 1.0)


def _minimized(
    simulator: Simulator,
    model: ModelAtEstimate,
    windows: Windows,
    places: IntArray,
    limits: Mapping[str, tuple[float, float]],
) -> tuple[ModelAtEstimate, _Information]:
    """Return the model at the best values of `places`, and the information there."""
    # Bounds keep a value finite that the windows determine badly.
    low, high = np.array([*limits.values()]).reshape(-1, 2).T
    q = model.q.copy()
    q[places] = np.clip(q[places], low, high)
    information = _information(simulator.at(q), windows, places)
    # Biases and trims are nearly linear: two or three iterations are enough.
    for _ in range(15):
        inverse = pseudo_inverse(information.matrix)
        step = inverse @ information.gradient
        # Halve a step that predicts worse by more than rounding, or leaves fewer numbers finite.
        for _ in range(8):
            trial = q.copy()
            trial[places] = np.clip(q[places] + step, low, high)
            at_trial = _information(simulator.at(trial), windows, places)
            is_worse = at_trial.mean_square > information.mean_square * (1 + 1e-6)
            if at_trial.numbers >= information.numbers and not is_worse:
                break
            step = step / 2
        else:
            break
        change = np.abs(trial - q)[places]
        q = trial
        information = at_trial
        if np.all(change <= 0.01 * np.sqrt(np.diag(inverse))):
            break
    return replace(model, q=q), information


def _information(simulator: Simulator, windows: Windows, places: IntArray) -> _Information:
    """Return the normal equations at the simulator's values.

    The first state of a window is an unknown mean of all windows plus a deviation with the spread
    of the prior.
    """
    simulated = simulator.windows(windows, places)
    initial, slopes = simulated.initial, simulated.slopes
    residuals, present = simulated.measured - simulated.outputs, np.isfinite(simulated.measured)
    finite = ~initial.not_finite & np.all(np.isfinite(slopes), axis=(1, 2, 3))
    finite &= np.all(np.isfinite(residuals) | ~present, axis=(1, 2))
    used = present & finite[:, None, None]

    n = initial.states.shape[1]
    weight = whitening(initial.noise)
    w = len(residuals)
    r = (np.where(used, residuals, 0.0) @ weight.T).reshape(w, -1)
    J = (weight @ np.where(used[..., None], slopes, 0.0)).reshape(w, r.shape[1], -1)
    by_state = J[..., :n]
    # A change of the mean moves the first states of all windows: it has the same derivatives.
    columns = np.concatenate([J[..., n:], by_state], axis=2)
    matrix = np.einsum("wma,wmb->ab", columns, columns)
    gradient = np.einsum("wma,wm->a", columns, r)
    squares = float(np.sum(r**2))

    if n:
        usable = np.any(used, axis=(1, 2))
        precision = np.nan_to_num(initial.precision)
        deviation = np.where(usable[:, None], initial.states - np.nan_to_num(initial.mean), 0.0)
        H = by_state.transpose(0, 2, 1) @ by_state + np.diag(precision)
        slope = np.einsum("wmn,wm->wn", by_state, r) - precision * deviation
        cross = by_state.transpose(0, 2, 1) @ columns
        matrix = matrix - np.einsum("wna,wnb->ab", cross, np.linalg.solve(H, cross))
        step = np.linalg.solve(H, slope[..., None])[..., 0]
        gradient = gradient - np.einsum("wna,wn->a", cross, step)
        squares += float(np.sum(precision * deviation**2) - np.sum(slope * step))

    # The deviations of single windows were eliminated above; now the mean is.
    a = len(places)
    mean = pseudo_inverse(matrix[a:, a:])
    gain = matrix[:a, a:] @ mean
    return _Information(
        matrix[:a, :a] - gain @ matrix[a:, :a],
        gradient[:a] - gain @ gradient[a:],
        squares - float(gradient[a:] @ mean @ gradient[a:]),
        int(used.sum()),
        (windows.lead + windows.horizon) / windows.horizon,
    )


def _eigen(matrix: Array) -> tuple[Array, Array, Array]:
    """Return eigenvalues and vectors of the matrix scaled to a diagonal of ones, and the scales."""
    diagonal = np.diag(matrix)
    scale = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    return values, vectors, scale


def pseudo_inverse(matrix: Array) -> Array:
    """Return the inverse of an information matrix (a, a), zero along undetermined directions."""
    if not len(matrix):
        return matrix
    values, vectors, scale = _eigen(matrix)
    determined = values > BLIND * max(float(values[-1]), 0.0)
    root = vectors[:, determined] / np.sqrt(values[determined])
    return (root @ root.T) * np.outer(scale, scale)


def _not_determined(information: _Information, limits: Mapping[str, tuple[float, float]]) -> str:
    """Return the name of the least determined value if it is undetermined, else ""."""
    # The samples do not change with such a value, or its error exceeds half of its bounds.
    names = list(limits)
    values, vectors, scale = _eigen(information.matrix)
    blind = np.flatnonzero(values <= BLIND * max(float(values[-1]), 0.0))
    if blind.size:
        share = np.where(scale > 0, np.max(np.abs(vectors[:, blind]), axis=1), 2.0)
        if np.max(share) > 0.01:
            return names[int(np.argmax(share))]
    low, high = np.array(list(limits.values())).T
    ratio = np.sqrt(np.diag(information.covariance)) / ((high - low) / 2)
    return names[int(np.argmax(ratio))] if ratio.max() > 1 else ""


def _covariance(simulator: Simulator, solution: _Solution) -> Array:
    """Return the covariance of all values, with those that were estimated from the record."""
    model = solution.model
    places = solution.places
    information = solution.information
    covariance = np.zeros((len(model.names),) * 2)
    if model.covariance is not None:
        covariance = model.covariance.copy()

    # The estimates follow the model's parameters, and share their errors.
    covariance[places] = 0.0
    covariance[:, places] = 0.0
    model_places = np.flatnonzero(np.isfinite(np.diag(covariance)) & (np.diag(covariance) > 0))
    a = len(places)
    joint = _information(
        simulator.at(model.q), solution.windows, np.concatenate([places, model_places])
    ).matrix
    follow = -pseudo_inverse(information.matrix) @ joint[:a, a:]
    shared = covariance[np.ix_(model_places, model_places)]
    covariance[np.ix_(places, model_places)] = follow @ shared
    covariance[np.ix_(model_places, places)] = (follow @ shared).T
    covariance[np.ix_(places, places)] = information.covariance + follow @ shared @ follow.T
    return covariance
