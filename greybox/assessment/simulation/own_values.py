"""Estimate the biases and trims of a record to which the model was not fitted.

The bias of a sensor and a trim parameter belong to a record, not to the model. On another record
they have other values: those that predict its windows best. Gauss-Newton steps on the samples of
all windows find these values. The model's parameters are fixed. The initial states of the windows
are unknown, too: they scatter about a mean that all windows share.
Source: Tischler and Remple (2012), Aircraft and Rotorcraft System Identification, 2nd ed., section
14.4: verification with biases and reference shifts estimated anew.
"""

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from greybox.assessment.simulation.model_at_estimate import ModelAtEstimate
from greybox.assessment.simulation.prediction import ROUNDING, Windows, cut
from greybox.assessment.simulation.simulator import Simulator
from greybox.assessment.simulation.state_estimation import whitening
from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import places_of, selected, without
from greybox.data.files.numbers_in_text import with_error
from greybox.data.files.wording import counted, listed
from greybox.engine.compiled.sampled_data import gapless
from greybox.modeling.formulation.signal_bias import bias_name, bias_parameter
from greybox.modeling.integrators import Integrator
from greybox.modeling.model import require_known
from greybox.modeling.parameter import Parameters, lower_and_upper
from greybox.statistics.column_space import pseudo_inverse

# Relative eigenvalue of the information below which a direction is not determined.
BLIND = 1e-9
# Most Gauss-Newton steps. Biases and trims are nearly linear: two or three are enough.
MOST_STEPS = 15
# Most halvings of a step.
MOST_HALVINGS = 8
# Mean square of the residuals of longer windows over that of shorter ones, up to which the longer
# ones are used. A tenth more in rms is due to slow errors of the model; with more, the free
# simulation no longer follows the record.
LARGEST_INCREASE = 1.2


def with_own_values(
    model: ModelAtEstimate,
    windows: Windows,
    integrator: Integrator | None,
    own: Sequence[str],
) -> tuple[ModelAtEstimate, dict[str, tuple[float, float]], tuple[str, ...]]:
    """Return the model with the values `own` estimated from the windows.

    Returns
    -------
    model : ModelAtEstimate
    values : mapping of name to (value, standard error)
        The estimated values. Their errors include those of the model's parameters.
    notes : tuple of str
        Sentences on what was estimated and what could not be.

    Raises
    ------
    ValueError
        If the model does not have a name, or the signal of a bias.
    """
    if not own:
        return model, {}, ()
    biased = _with_biases(model, own)
    parameters = selected(biased.declared, own)
    record = windows.record
    for signal in biased.criterion.biases:
        name = bias_name(signal)
        is_asked = name in own and name not in parameters
        if is_asked and np.isfinite(record.signals.get(signal, np.nan)).any():
            parameters[name] = bias_parameter(signal, record)
    simulator = Simulator(biased, windows.outputs, integrator)

    # Short windows come first: they follow the record even with wrong values.
    estimate = _estimated(simulator, biased, windows, parameters)
    for longer in _longer_windows(windows):
        candidate = _estimated(simulator, estimate.model, longer, parameters)
        reference = estimate.mean_square if estimate.names else math.inf
        limit = LARGEST_INCREASE * max(reference, 1.0)
        if not candidate.names or candidate.mean_square > limit:
            break
        if candidate.certainty > estimate.certainty:
            estimate = candidate

    title = record.name or "the record"
    undetermined = [name for name in unique(own) if name not in estimate.names]
    notes: tuple[str, ...] = ()
    if undetermined:
        notes = (
            f"{listed(undetermined)}: not determined by {title}; the value of the fit is used.",
        )
    if not estimate.names:
        return model, {}, notes

    covariance = _covariance(simulator, estimate)
    errors = np.sqrt(np.diag(covariance)[estimate.places])
    values = {}
    texts = []
    for k, name in enumerate(estimate.names):
        value, error = float(estimate.values[k]), float(errors[k])
        values[name] = (value, error)
        unit = parameters[name].unit
        number = " ± ".join(with_error(value, error))
        texts.append(f"{name} = {number} {'' if unit == '1' else unit}".rstrip())
    rows = np.unique(estimate.windows.rows)
    numbers = sum(int(np.isfinite(record[name][rows]).sum()) for name in windows.outputs)
    note = (
        f"{listed(texts)} {'was' if len(texts) == 1 else 'were'} estimated from {title} "
        f"itself: {counted(len(texts), 'value')} from {counted(numbers, 'number')}, "
        "for which the record is not held out."
    )
    return replace(estimate.model, covariance=covariance), values, (note, *notes)


@frozen
class _Estimate:
    """A model, and the normal equations of its values at `places`, linearized at these values.

    The initial states of the windows and their mean are eliminated from the equations.

    Attributes
    ----------
    model : ModelAtEstimate
    windows : Windows
    places : (a,) int array
        Places of the estimated values among those of the model.
    matrix, gradient : (a, a) and (a,) arrays
        Normal equations: `matrix` times a step equals `gradient`.
    squares : float
        Sum of the squared weighted residuals.
    numbers : int
        Number of residuals.
    """

    model: ModelAtEstimate
    windows: Windows
    places: IntArray
    matrix: Array
    gradient: Array
    squares: float
    numbers: int

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.model.names[k] for k in self.places)

    @property
    def values(self) -> Array:
        return self.model.q[self.places]

    @property
    def mean_square(self) -> float:
        return self.squares / max(self.numbers, 1)

    @property
    def inverse(self) -> Array:
        return pseudo_inverse(self.matrix, BLIND)

    @property
    def covariance(self) -> Array:
        """The covariance (a, a) by the noise of the fit, or by the residuals if they are larger."""
        # The lead-in of a window is the horizon of another: measurements are used more than once.
        overlap = (self.windows.lead + self.windows.horizon) / self.windows.horizon
        return self.inverse * overlap * max(self.mean_square, 1.0)

    @property
    def certainty(self) -> tuple[int, float]:
        """Number of values, and minus the sum of the logarithms of their variances."""
        return len(self.places), -float(np.sum(np.log(np.diag(self.covariance))))


def _longer_windows(windows: Windows) -> Iterator[Windows]:
    """Yield windows of the record, each four times as long as the last, to the longest stretch.

    The longer a free simulation is, the better it shows constant errors.
    """
    record, outputs = windows.record, windows.outputs
    if not record.has_time:
        return

    # No window extends across a gap, behind which the state is unknown.
    inputs = windows.inputs
    lead, horizon = windows.lengths
    stretches = gapless(record, inputs, outputs)
    longest_stretch = max(float(stretch.steps.sum()) for stretch in stretches)
    longest_horizon = longest_stretch - lead
    while horizon < (1 - ROUNDING) * longest_horizon:
        horizon = min(4 * horizon, longest_horizon)
        with contextlib.suppress(ValueError):  # no outputs were measured in them
            yield cut(record, inputs, outputs, lead=lead, horizon=horizon)


def _estimated(
    simulator: Simulator,
    model: ModelAtEstimate,
    windows: Windows,
    parameters: Parameters,
) -> _Estimate:
    """Estimate those of the `parameters` that the windows determine; the others stay."""
    while True:
        estimate = _minimized(simulator, model, windows, parameters)
        undetermined = _least_determined(estimate, parameters) if parameters else None
        if undetermined is None:
            return estimate
        # One at a time: without that value, the record may determine the others.
        parameters = without(parameters, (undetermined,))


def _with_biases(model: ModelAtEstimate, own: Sequence[str]) -> ModelAtEstimate:
    """Return the model with a bias of zero for every signal in `own` that has none yet."""
    signals = {bias_name(name): name for name in (*model.system.outputs, *model.system.inputs)}
    new = [name for name in unique(own) if name in signals and name not in model.names]
    require_known(own, (*model.names, *new), "parameter", model.label)
    biases = (*model.criterion.biases, *(signals[name] for name in new))
    covariance = model.covariance

    # The fit had no such bias, hence no error of it: only the record estimates it.
    if covariance is not None:
        covariance = np.pad(covariance, ((0, len(new)), (0, len(new))))
    return replace(
        model,
        names=(*model.names, *new),
        q=np.pad(model.q, (0, len(new))),
        covariance=covariance,
        criterion=replace(model.criterion, biases=biases),
    )


def _minimized(
    simulator: Simulator,
    model: ModelAtEstimate,
    windows: Windows,
    parameters: Parameters,
) -> _Estimate:
    """Return the best values of the parameters, within their bounds."""
    # Bounds keep a value finite that the windows determine badly.
    low, high = lower_and_upper(parameters.values())
    places = places_of(parameters, model.names)

    def at(values: Array) -> _Estimate:
        q = model.q.copy()
        q[places] = np.clip(values, low, high)
        return _linearized(simulator, replace(model, q=q), windows, places)

    def after_step(start: _Estimate, step: Array) -> _Estimate | None:
        """Return the estimate after a step, halved until it predicts as well; None if it fails."""
        for _ in range(MOST_HALVINGS):
            trial = at(start.values + step)
            # Rounding does not make a step worse. One that leaves fewer numbers finite is.
            is_worse = trial.mean_square > start.mean_square * (1 + 1e-6)
            if trial.numbers >= start.numbers and not is_worse:
                return trial
            step = step / 2
        return None

    best = at(model.q[places])
    for _ in range(MOST_STEPS):
        inverse = best.inverse
        trial = after_step(best, inverse @ best.gradient)
        if trial is None:
            break
        change = np.abs(trial.values - best.values)
        best = trial
        # A hundredth of a standard error does not change the answer.
        if np.all(change <= 0.01 * np.sqrt(np.diag(inverse))):
            break
    return best


def _linearized(
    simulator: Simulator, model: ModelAtEstimate, windows: Windows, places: IntArray
) -> _Estimate:
    """Return the normal equations of the values at `places`.

    The initial state of a window is the unknown mean over all windows, plus a deviation with the
    spread of the prior.
    """
    simulated = simulator.at(model.q).windows(windows, places)
    initial, slopes = simulated.initial, simulated.slopes
    residuals = simulated.measured - simulated.outputs
    present = np.isfinite(simulated.measured)
    finite = ~simulated.not_finite & np.all(np.isfinite(slopes), axis=(1, 2, 3))
    used = present & finite[:, None, None]

    # The columns are the derivatives by the initial state (n), by the values (a), and the residual:
    # one product transforms all of them.
    w, n = initial.states.shape
    a = len(places)
    columns = np.concatenate([slopes, residuals[..., None]], axis=3)
    columns = whitening(initial.noise) @ np.where(used[..., None], columns, 0.0)
    columns = columns.reshape(w, -1, n + a + 1)

    # The prior of the deviations adds rows, in which the mean of all states has no part.
    root = np.sqrt(np.nan_to_num(initial.precision))
    deviation = np.where(used.any(axis=(1, 2))[:, None], initial.states - initial.mean, 0.0)
    prior = np.zeros((w, n, n + a + 1))
    prior[..., -1] = -root * deviation
    by_state = np.hstack([columns[..., :n], np.broadcast_to(np.diag(root), (w, n, n))])
    columns = np.hstack([columns, prior])
    basis = np.linalg.qr(by_state)[0]
    columns = columns - basis @ (basis.mT @ columns)

    # The deviations of single windows were eliminated above; now the mean is.
    flat = columns.reshape(-1, n + a + 1)
    gram = flat.T @ flat
    mean = pseudo_inverse(gram[:n, :n], BLIND)
    gram = gram[n:, n:] - gram[n:, :n] @ mean @ gram[:n, n:]
    numbers = int(used.sum())
    return _Estimate(
        model=model,
        windows=windows,
        places=places,
        matrix=gram[:a, :a],
        gradient=gram[:a, a],
        squares=float(gram[a, a]),
        numbers=numbers,
    )


def _least_determined(estimate: _Estimate, parameters: Parameters) -> str | None:
    """Return the name of the least determined value; None if all are determined."""
    # Share of each value in combinations that change no sample. Rounding leaves less than 1e-4.
    invisible = 1 - np.diag(estimate.inverse @ estimate.matrix)
    if invisible.max() > 1e-4:
        return estimate.names[np.argmax(invisible)]
    # A value whose error exceeds half of its bounds is not determined either.
    low, high = lower_and_upper(parameters.values())
    ratio = np.sqrt(np.diag(estimate.covariance)) / ((high - low) / 2)
    return estimate.names[np.argmax(ratio)] if ratio.max() > 1 else None


def _covariance(simulator: Simulator, estimate: _Estimate) -> Array:
    """Return the covariance of all values, with those that were estimated from the record."""
    model = estimate.model
    places = estimate.places
    count = len(model.names)
    covariance = np.zeros((count, count))
    if model.covariance is not None:
        covariance = model.covariance.copy()

    # The estimates depend on the model's parameters, and share their errors.
    covariance[places] = 0.0
    covariance[:, places] = 0.0
    given = np.flatnonzero(np.nan_to_num(np.diag(covariance)) > 0)
    joint = np.concatenate([places, given])
    a = len(places)
    matrix = _linearized(simulator, model, estimate.windows, joint).matrix
    sensitivity = np.vstack([-estimate.inverse @ matrix[:a, a:], np.eye(len(given))])
    joint_covariance = sensitivity @ covariance[np.ix_(given, given)] @ sensitivity.T
    joint_covariance[:a, :a] += estimate.covariance
    covariance[np.ix_(joint, joint)] = joint_covariance
    return covariance
