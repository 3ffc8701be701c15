"""The regressions of a record: smoothed states, delayed inputs, and one filter for all terms."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from greybox.data.intersample import Intersample
from greybox.data.record import Record, median_step
from greybox.files.arrays import Array
from greybox.modeling.held_inputs import held_response
from greybox.regression.least_squares import Rows
from greybox.regression.linear_in_parameters import Equations
from greybox.regression.smoothing import (
    differentiate,
    low_pass,
    reach,
    smooth,
    stretches,
    without_holes,
)

# Cutoff of an equation's terms over the lowest cutoff of its signals. With 1, what smoothing took
# from the signals biases the tilt model by many standard errors; with 0.7 and 0.5, the intervals
# cover; with 0.35, precision is lost.
SHARE = 0.5
# Share of its unknown initial value that a simulated state may still have where its rows begin. An
# error of 1 % that decays within a few rows is far below the effect of noise in the regressors.
REMEMBERED = 0.01
FEWEST = 4  # remaining rows of a stretch: fewer add nothing to the thousands of a record


@dataclass(frozen=True, eq=False)
class Regressors:
    """The regressions of a record.

    Attributes
    ----------
    rows : Rows
        Every equation over every stretch.
    bands : tuple of float
        Cutoff of the filter that all terms of an equation pass, rad/s; infinite if no signal was
        smoothed.
    """

    rows: Rows
    bands: tuple[float, ...]


def regressors(
    equations: Equations, record: Record, p: Array, between: Mapping[str, Intersample]
) -> Regressors:
    """Smooth the signals of a regular record, and make the regressions.

    Parameters
    ----------
    p : (number of free parameters,) array
        Their starts: those that enter linearly have no effect here.
    between : mapping of input name to Intersample
        How the inputs run between samples.

    Raises
    ------
    ValueError
        If no stretch is long enough.
    """
    time = record.time
    step = median_step(time)
    x = np.full((len(equations.state_names), time.size), np.nan)
    derivatives: dict[str, Array] = {}
    cutoffs: dict[str, float] = {}
    for state in equations.states:
        if state.how == "signal":
            smoothed = smooth(time, record[state.source])
            cutoffs[state.source] = smoothed.cutoff
            signal = smoothed.values
        elif state.how == "derivative":
            signal = derivatives[state.source]
        else:
            continue
        # The formula may use the states before this one; others stay NaN, and it has no use of
        # them.
        if state.value is not None:
            signal = np.asarray(state.value(x, signal[None, :])).ravel()
        x[equations.state_names.index(state.name)] = signal
        derivatives[state.name] = differentiate(time, signal)

    u = np.full((len(equations.input_names), time.size), np.nan)
    lateness = 0.0
    delays = np.asarray(equations.delay(p)).ravel().tolist()
    for row, name, delay in zip(u, equations.input_names, delays, strict=True):
        course = between[name]
        row[:] = _delayed(time, without_holes(time, record[name]), delay + course.late, course.held)
        lateness = max(lateness, delay + (step if course.held else course.late))
    lateness += _simulate(equations, time, x, u, p)

    base, slopes = (np.asarray(value) for value in equations.rows(x, u, p))
    slopes = slopes.reshape(len(base), time.size, -1)
    bands = tuple(
        SHARE * min((cutoffs[s] for s in e.signals), default=math.inf) for e in equations.equations
    )
    filtered = []
    for k, (equation, band) in enumerate(zip(equations.equations, bands, strict=True)):
        is_derivative = equation.kind == "derivative"
        target = (
            derivatives[equation.target]
            if is_derivative
            else without_holes(time, record[equation.target])
        )
        columns = np.column_stack([target, base[k], slopes[k]])
        filtered.append(_filtered(time, columns, band, lateness))

    columns = np.vstack(filtered)
    if not len(columns):
        longest = max(rows.stop - rows.start for rows in stretches(time, time))
        lost = 2 * reach(min(bands)) + lateness
        raise ValueError(
            "no stretch without a gap is long enough: the longest piece of the record has "
            f"{longest * step:.3g} s, of which smoothing, delays and simulated states need "
            f"{lost:.3g} s at its ends; give a longer or less noisy record."
        )
    equation = np.repeat(np.arange(len(base)), [len(rows) for rows in filtered])
    return Regressors(Rows(equation, columns[:, 0], columns[:, 1], columns[:, 2:]), bands)


def _filtered(time: Array, columns: Array, band: float, lateness: float) -> Array:
    """Return columns (n, k) of an equation, filtered, without the ends of every stretch."""
    step = median_step(time)
    # The filter is less accurate near the ends of a stretch. Delayed inputs are not known at its
    # beginning, where simulated states have not settled.
    edge = math.ceil(reach(band) / step)
    late = math.ceil(lateness / step)
    result = [columns[:0]]
    for rows in stretches(time, columns.sum(axis=1)):
        if rows.stop - rows.start < 2 * edge + late + FEWEST:
            continue
        part = columns[rows]
        if math.isfinite(band):
            part = low_pass(part, step, band)
        result.append(part[edge + late : len(part) - edge])
    return np.vstack(result)


def acting(time: Array, values: Array) -> Array:
    """Return a held input (n,) as the derivative of a smooth curve through the driven state has it.

    A state that integrates a held input is a straight line from sample to sample. A smooth curve
    through its samples has the slope S(t - h/2), where S is the smooth curve through the samples of
    the input, with oscillations enlarged by 1 / sinc(ωh/2) = 1 + (ωh)² / 24 + ... The second
    derivative of S adds this. Derivation: the pulse transfer function of an integrator behind a
    zero-order hold is h / (z - 1), and jωh / (z - 1) = exp(-jωh/2) / sinc(ωh/2).
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415  (imports slowly)

    step = (time[-1] - time[0]) / (time.size - 1)
    spline = CubicSpline(time, values)
    middle = np.maximum(time - step / 2, time[0])
    return spline(middle) - step**2 / 24 * spline(middle, 2)


def _delayed(time: Array, values: Array, late: float, held: bool) -> Array:
    """Return an input (n,) `late` seconds later, by an interpolating spline for every stretch.

    It is cubic, but linear for a held input: if the delay is a fraction of a step, the driven state
    sees two neighboring values, each for its share of the step.
    """
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415  (takes a quarter of a second)

    result = np.full(time.size, np.nan)
    for rows in stretches(time, values):
        t, u = time[rows], values[rows]
        if t.size > 3:
            course, order = (acting(t, u), 1) if held else (u, 3)
            spline = make_interp_spline(t, course, k=order)
            result[rows] = spline(np.clip(t - late, t[0], t[-1]))
    return result


def _simulate(equations: Equations, time: Array, x: Array, u: Array, p: Array) -> float:
    """Fill in the simulated states, and return how long they remember where they began, s."""
    names = [state.name for state in equations.states if state.how == "simulated"]
    if not names:
        return 0.0
    drive, matrix = (np.asarray(value) for value in equations.simulated(x, u, p))
    matrix = matrix[:, : len(names)]
    places = [equations.state_names.index(name) for name in names]
    for rows in stretches(time, *drive):
        if rows.stop - rows.start > 1:
            x[places, rows] = _linear_response(matrix, drive[:, rows], median_step(time))
    return math.log(1 / REMEMBERED) / float(np.min(-np.linalg.eigvals(matrix).real))


def _linear_response(matrix: Array, drive: Array, step: float) -> Array:
    """Solve ``x' = matrix x + drive`` (s, n) from the equilibrium at the first sample.

    Source: first-order hold, Franklin, Powell and Workman, Digital Control of Dynamic Systems; the
    recursion runs in the Schur basis.
    """
    from scipy.linalg import schur  # noqa: PLC0415  (imports slowly)
    from scipy.signal import lfilter  # noqa: PLC0415  (takes a third of a second to import)

    s = len(matrix)
    unit = np.eye(s)
    triangle, basis, *_ = schur(matrix, output="complex")
    # The drive is a state whose derivative, its change over the step, is held.
    with_drive = np.block([[triangle, unit], [np.zeros((s, 2 * s))]])
    transition, effect = held_response(with_drive, np.vstack([0 * unit, unit / step]), step)
    exponential, hold = transition[:s, :s], transition[:s, s:]
    ramp = effect[:s]

    # In the Schur basis, each state is driven by those after it only: one scalar recursion after
    # another.
    drive = basis.conj().T @ drive
    # The mean of straight lines over a step then equals that of the smooth curve to fourth order.
    drive[:, 1:-1] -= np.diff(drive, 2) / 12
    added = (hold - ramp) @ drive[:, :-1] + ramp @ drive[:, 1:]
    z = np.zeros(drive.shape, complex)
    # The initial state is unknown: the equilibrium with the first input is the best guess.
    start = np.linalg.solve(triangle, -drive[:, 0])
    for k in reversed(range(s)):
        right = added[k] + exponential[k, k + 1 : s] @ z[k + 1 :, :-1]
        z[k] = lfilter([1.0], [1.0, -exponential[k, k]], np.concatenate([[start[k]], right]))
    return (basis @ z).real
