"""The regressions of a record: smoothed states, delayed inputs, and one filter for all terms."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

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
    """The signals of a record as the equations need them; `rows` makes the regressions.

    Attributes
    ----------
    time : (n,) array, s
        Uniform but for gaps.
    states : (k, n) array
        The states of the model that are known without simulation; NaN where unknown.
    targets : tuple of (n,) arrays
        Left sides of the equations: derivatives and outputs.
    between : mapping of name to Intersample
    cutoffs, noise : mapping of signal name to float
        Cutoffs of the smoothed signals, rad/s, and standard deviations of the removed noise.
    bands : tuple of float
        Cutoff of the filter that all terms of an equation pass, rad/s; infinite if no signal was
        smoothed.
    lateness : float, s
        Time at the beginning of a stretch for which delayed inputs or simulated states are unknown.
    splines : mapping of name to list of (slice, function)
        The inputs as they act without their delay, for every stretch: a held input acts half a
        sample late, see `acting`.
    """

    equations: Equations
    time: Array
    states: Array
    targets: tuple[Array, ...]
    between: Mapping[str, Intersample]
    cutoffs: Mapping[str, float]
    noise: Mapping[str, float]
    bands: tuple[float, ...]
    lateness: float
    splines: Mapping[str, list[tuple[slice, Callable[[Array], Array]]]] = field(repr=False)

    @property
    def step(self) -> float:
        """Sampling interval, s."""
        return median_step(self.time)

    def rows(self, p: Array) -> Rows:
        """Return every equation over every stretch, at the values `p` of the free parameters.

        There are no rows where a simulated state grows without bound.
        """
        u = self.delayed_inputs(np.asarray(self.equations.delay(p)).ravel())
        x = self.states.copy()
        # An unstable state would grow beyond all numbers within a record: it stays unknown.
        self.simulate(x, u, p)
        base, slopes = (np.asarray(value) for value in self.equations.rows(x, u, p))
        slopes = slopes.reshape(len(base), self.time.size, -1)
        filtered = [self._filtered(k, base[k], slopes[k]) for k in range(len(base))]
        equation = np.repeat(np.arange(len(base)), [len(columns) for columns in filtered])
        columns = np.vstack(filtered)
        return Rows(equation, columns[:, 0], columns[:, 1], columns[:, 2:])

    def _filtered(self, k: int, base: Array, slopes: Array) -> Array:
        """Return target, base and slopes of an equation (rows, 2 + parameters), filtered."""
        band = self.bands[k]
        columns = np.column_stack([self.targets[k], base, slopes])

        # The filter is less accurate near the ends of a stretch, and simulated states have not
        # settled at its beginning.
        edge = math.ceil(reach(band) / self.step)
        late = math.ceil(self.lateness / self.step)
        result = [columns[:0]]
        for rows in stretches(self.time, columns.sum(axis=1)):
            if rows.stop - rows.start < 2 * edge + late + FEWEST:
                continue
            part = columns[rows]
            if math.isfinite(band):
                part = low_pass(part, self.step, band)
            result.append(part[edge + late : len(part) - edge])
        return np.vstack(result)

    def delayed_inputs(self, delays: Array) -> Array:
        """Return the inputs (m, n) after their delays."""
        rows = np.full((len(delays), self.time.size), np.nan)
        for row, name, delay in zip(rows, self.equations.input_names, delays, strict=True):
            late = delay + self.between[name].late
            for part, spline in self.splines[name]:
                time = self.time[part]
                row[part] = spline(np.clip(time - late, time[0], time[-1]))
        return rows

    def simulate(self, x: Array, u: Array, p: Array) -> None:
        """Fill in the simulated states if they are stable."""
        names = self.equations.simulated_names
        if not names:
            return
        drive, matrix = (np.asarray(value) for value in self.equations.simulated(x, u, p))
        matrix = matrix[:, : len(names)]
        if not np.all(np.isfinite(matrix)) or np.max(np.linalg.eigvals(matrix).real) >= 0:
            return
        places = [self.equations.state_names.index(name) for name in names]
        for rows in stretches(self.time, *drive):
            if rows.stop - rows.start > 1:
                x[places, rows] = _linear_response(matrix, drive[:, rows], self.step)


def regressors(
    equations: Equations,
    record: Record,
    p: Array,
    latest: Array,
    between: Mapping[str, Intersample],
    *,
    cutoffs: Mapping[str, float] | None = None,
) -> Regressors:
    """Smooth the signals of a regular record.

    Parameters
    ----------
    p : (number of free parameters,) array
        Start values, at which the memory of simulated states is computed.
    latest : (number of inputs,) array, s
        The largest possible delays.
    between : mapping of input name to Intersample
        How the inputs run between samples.
    cutoffs : mapping of signal name to rad/s, optional
        By default each signal chooses its own.
    """
    time = record.time
    x = np.full((len(equations.state_names), time.size), np.nan)
    derivatives: dict[str, Array] = {}
    used = dict(cutoffs or {})
    noise: dict[str, float] = {}
    for state in equations.states:
        if state.how == "signal":
            smoothed = smooth(time, record[state.source], used.get(state.source))
            used[state.source] = smoothed.cutoff
            noise[state.source] = smoothed.noise
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

    longest = [
        delay + (record.step if between[n].held else between[n].late)
        for n, delay in zip(equations.input_names, latest, strict=True)
    ]
    return Regressors(
        equations=equations,
        time=time,
        states=x,
        targets=tuple(
            derivatives[e.target]
            if e.kind == "derivative"
            else without_holes(time, record[e.target])
            for e in equations.equations
        ),
        between=between,
        cutoffs=used,
        noise=noise,
        bands=tuple(
            SHARE * min((used[s] for s in e.signals), default=math.inf) for e in equations.equations
        ),
        lateness=max(longest, default=0.0) + memory(equations, p),
        splines={
            name: _splines(time, without_holes(time, record[name]), between[name].held)
            for name in equations.input_names
        },
    )


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


def _splines(
    time: Array, values: Array, held: bool
) -> list[tuple[slice, Callable[[Array], Array]]]:
    """Return an interpolating spline for every stretch of an input.

    It is cubic, but linear for a held input: if the delay is a fraction of a step, the driven state
    sees two neighboring values, each for its share of the step.
    """
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415  (takes a quarter of a second)

    splines = []
    for rows in stretches(time, values):
        t, u = time[rows], values[rows]
        if t.size > 3:
            course, order = (acting(t, u), 1) if held else (u, 3)
            splines.append((rows, make_interp_spline(t, course, k=order)))
    return splines


def memory(equations: Equations, p: Array) -> float:
    """Return how long simulated states remember where they began, s."""
    if not equations.simulated_names:
        return 0.0
    rest = (np.zeros(len(equations.state_names)), np.zeros(len(equations.input_names)))
    matrix = np.asarray(equations.simulated(*rest, p)[1])
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
