"""What the answers are compared with: SciPy's integration, and its least squares from the truth.

All perturbed parameter vectors are columns of one integration, so that a Jacobian by central
differences costs one pass over the record. Input corners lie between the pieces that are
integrated, never within one; with a delay, every column has its own corners, so each piece runs
over a time of its own from 0 to 1.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import least_squares

from differential.clocks import Motion
from differential.models import Plant

# Error of a piece of the trajectory, whose states are of order one.
RELATIVE, ABSOLUTE = 1e-9, 1e-11

# Relative steps of the central differences: the third derivative costs about 1e-9 of a derivative,
# and the integration, whose error all columns share, no more.
DIFFERENCE = 1e-5

# Innovations gains, (states, outputs, m), and the measured outputs (outputs, n) that they correct to.
Correction = tuple[np.ndarray, np.ndarray]


def trajectory(
    plant: Plant,
    values: Mapping[str, np.ndarray],
    initial: np.ndarray,
    time: np.ndarray,
    motion: Motion,
    correction: Correction | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return outputs (outputs, n, m) and states (states, n, m) at `time` (n,), in s.

    Parameters
    ----------
    values : mapping of parameter to (m,) array
    initial : (states, m) array
        The states at the first time.
    motion : Motion
        The inputs at `time`; before, each rests at its first value.
    correction : Correction, optional
        States are corrected by the innovations of each sample after its outputs are compared.
        Samples without a measurement (NaN) correct nothing. Not for delays.
    """
    columns = initial.shape[1]
    lags = [np.broadcast_to(values[plant.delays[i]], columns) for i in plant.delays]
    breaks = [np.clip(time[:, None] + lag, time[0], time[-1]) for lag in (np.zeros(columns), *lags)]
    order = np.argsort(np.vstack(breaks), axis=0, kind="stable")
    grid = np.take_along_axis(np.vstack(breaks), order, axis=0)
    # Where each sample is in the grid of each column.
    place = np.argsort(order, axis=0, kind="stable")[: time.size]

    lag_of = np.zeros((len(plant.inputs), columns))
    for row, name in enumerate(plant.inputs):
        if name in plant.delays:
            lag_of[row] = values[plant.delays[name]]
    begin, end = _between(time, motion, grid, lag_of)
    shown = _at_samples(time, motion, lag_of)

    states = np.empty((initial.shape[0], grid.shape[0], columns))
    outputs = np.empty((len(plant.outputs), time.size, columns))
    x = states[:, 0] = np.array(initial, float)
    for k in range(grid.shape[0]):
        if correction is not None:
            outputs[:, k] = plant.output(x, shown[:, k], values)
            gains, measured = correction
            innovation = np.nan_to_num(measured[:, k, None] - outputs[:, k])
            x = x + np.einsum("soc,oc->sc", gains, innovation)
        if k + 1 < grid.shape[0]:
            length = grid[k + 1] - grid[k]
            if np.any(length > 0):
                x = advance(plant, values, x, begin[:, k], end[:, k], length)
            states[:, k + 1] = x

    at_samples = np.take_along_axis(states, place[None], axis=1)
    if correction is None:
        flat = at_samples.reshape(len(states), -1), shown.reshape(len(shown), -1)
        repeated = {
            name: np.tile(np.broadcast_to(v, columns), time.size) for name, v in values.items()
        }
        outputs = plant.output(*flat, repeated).reshape(outputs.shape)
    return outputs, at_samples


def advance(plant, values, x, begin, end, length):
    """Return the states (states, m) after `length` (m,), in s, in which inputs run straight.

    `x` (states, m) are those before, `begin` and `end` (inputs, m) the inputs.
    """

    def slope(share, flat):
        inputs = begin + share * (end - begin)
        return (length * plant.derivative(flat.reshape(x.shape), inputs, values)).ravel()

    solver = DOP853(slope, 0.0, x.ravel(), 1.0, first_step=1.0, rtol=RELATIVE, atol=ABSOLUTE)
    while solver.status == "running":
        solver.step()
    if solver.status == "failed":
        raise ArithmeticError("The reference diverges.")
    return solver.y.reshape(x.shape)


def _between(time, motion, grid, lags):
    """Return the inputs at the beginning and at the end of each piece, (inputs, pieces, m)."""
    begin, end = (np.empty((len(lags), len(grid) - 1, grid.shape[1])) for _ in range(2))
    for row, lag in enumerate(lags):
        left, right = grid[:-1] - lag, grid[1:] - lag
        sample = np.searchsorted(time, (left + right) / 2, side="right") - 1
        begin[row] = _along(time, motion, row, left, sample)
        end[row] = _along(time, motion, row, right, sample)
    return begin, end


def _at_samples(time, motion, lags):
    """Return the inputs that the outputs at the samples feel, (inputs, n, m)."""
    shown = np.empty((len(lags), time.size, lags.shape[1]))
    for row, lag in enumerate(lags):
        at = time[:, None] - lag
        shown[row] = _along(time, motion, row, at, np.searchsorted(time, at, side="right") - 1)
    return shown


def _along(time, motion, row, at, sample):
    """Return one input at the times `at`, along the piece that begins at `sample`; -1 is before."""
    values = motion.values[row]
    first = np.maximum(sample, 0)
    if motion.held:
        return values[first]
    next_one = np.minimum(first + 1, time.size - 1)
    length = np.where(next_one > first, time[next_one] - time[first], 1.0)
    line = values[first] + (values[next_one] - values[first]) * (at - time[first]) / length
    return np.where(sample < 0, values[0], line)


@dataclass(frozen=True)
class Minimum:
    """The least-squares minimum beside the truth.

    Attributes
    ----------
    values : (p,) array
    error : (p,) array
        Standard errors, for independent residuals of variance one.
    half_squares : float
        Half the sum of the squared residuals there.
    clear : bool
        Whether SciPy converged inside the bounds to a point that the data determine.
    """

    values: np.ndarray
    error: np.ndarray
    half_squares: float
    clear: bool


def least_squares_minimum(
    residuals: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    scale: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
) -> Minimum:
    """Return the minimum of half the sum of squared residuals near `start` (p,).

    Parameters
    ----------
    residuals : function of (p, m) to (r, m)
        For m vectors at once.
    scale : (p,) array
        Sizes of the unknowns, for steps and differences.
    bounds : pair of (p,) arrays
    """
    passes: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def one_pass(v):
        if v.tobytes() not in passes:
            steps = DIFFERENCE * scale
            shifts = np.hstack([np.zeros((v.size, 1)), np.diag(steps), -np.diag(steps)])
            r = residuals(v[:, None] + shifts)
            passes.clear()
            passes[v.tobytes()] = r[:, 0], (r[:, 1 : v.size + 1] - r[:, v.size + 1 :]) / (2 * steps)
        return passes[v.tobytes()]

    best = least_squares(
        lambda v: one_pass(v)[0],
        start,
        lambda v: one_pass(v)[1],
        bounds=bounds,
        x_scale=scale,
        xtol=1e-8,
        ftol=1e-10,  # of the cost: 1e-4 standard errors of a record of 100 samples
        gtol=1e-12,
        max_nfev=20,
    )
    information = best.jac.T @ best.jac
    error = np.sqrt(np.diag(np.linalg.pinv(information, hermitian=True)))
    near_bound = np.minimum(best.x - bounds[0], bounds[1] - best.x) < 3 * error
    determined = np.linalg.cond(best.jac / np.linalg.norm(best.jac, axis=0)) < 1e3
    clear = best.status > 0 and determined and not near_bound.any()
    return Minimum(best.x, error, best.cost, bool(clear))
