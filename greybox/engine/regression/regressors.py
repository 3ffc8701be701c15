"""The regressions of a record: smoothed states, delayed inputs, and one filter for all terms."""

import math
from collections.abc import Mapping

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.intersample import Intersample
from greybox.data.record import Record
from greybox.engine.regression.least_squares import Rows
from greybox.engine.regression.linear_in_parameters import Equations
from greybox.engine.regression.smoothing import (
    differentiate,
    low_pass,
    mean_step,
    reach,
    smooth,
    stretches,
    without_holes,
)

FEWEST = 4  # remaining rows of a stretch: fewer add nothing to the thousands of a record


def regressors(
    equations: Equations, record: Record, p: Array, between: Mapping[str, Intersample]
) -> tuple[Rows, tuple[float, ...]]:
    """Smooth the signals of a regular record, and make the regressions.

    Returns
    -------
    rows : Rows
        Every equation over every stretch.
    bands : tuple of float
        Cutoff of the filter that all terms of an equation pass, rad/s; infinite if no signal was
        smoothed.

    Parameters
    ----------
    p : (number of free parameters,) array
        Their starts: those that enter linearly have no effect here.
    between : mapping of input name to Intersample
        How the inputs vary between samples.

    Raises
    ------
    ValueError
        If no stretch is long enough.
    """
    time = record.time
    x = np.full((len(equations.state_names), time.size), np.nan)
    derivatives: dict[str, Array] = {}
    cutoffs: dict[str, float] = {}
    for state in equations.states:
        if state.how == "signal":
            signal, cutoffs[state.source] = smooth(time, record[state.source])
        else:
            signal = derivatives[state.source]
        # The formula may use the states before this one; others stay NaN, and it has no use of
        # them.
        signal = np.asarray(state.value(x, signal[None, :])).ravel()
        x[equations.state_names.index(state.name)] = signal
        derivatives[state.name] = differentiate(time, signal)

    u = np.full((len(equations.input_names), time.size), np.nan)
    lateness = 0.0
    delays = np.asarray(equations.delay(p)).ravel().tolist()
    for row, name, delay in zip(u, equations.input_names, delays, strict=True):
        course = between[name]
        row[:] = _delayed(time, without_holes(time, record[name]), delay + course.late, course.held)
        lateness = max(lateness, delay + (record.step if course.held else course.late))

    base, slopes = [matrix.full() for matrix in equations.rows(x, u, p)]
    slopes = slopes.reshape(len(base), time.size, -1)
    # Share of the lowest cutoff of the signals of an equation. With 1, what smoothing took from the
    # signals biases the tilt model by many standard errors; with 0.7 and 0.5, the intervals cover;
    # with 0.35, precision is lost.
    bands = tuple(
        0.5 * min((cutoffs[s] for s in e.signals), default=math.inf) for e in equations.equations
    )
    filtered = []
    for k, (equation, band) in enumerate(zip(equations.equations, bands, strict=True)):
        target = (
            derivatives[equation.target]
            if equation.kind == "derivative"
            else without_holes(time, record[equation.target])
        )
        columns = np.column_stack([target, base[k], slopes[k]])
        # The filter is less accurate near the ends of a stretch, and at its beginning delayed
        # inputs are not known.
        parts = [columns[:0]]
        for rows in stretches(time, columns.sum(axis=1)):
            if rows.stop - rows.start < FEWEST:
                continue
            step = mean_step(time[rows])
            # Rounding must not turn a delay of whole samples into one sample more.
            edge, late = math.ceil(reach(band) / step), math.ceil(lateness / step - 1e-6)
            if rows.stop - rows.start >= 2 * edge + late + FEWEST:
                part = low_pass(columns[rows], step, band)
                parts.append(part[edge + late : len(part) - edge])
        filtered.append(np.vstack(parts))

    columns = np.vstack(filtered)
    if not len(columns):
        longest = max(np.ptp(time[rows]) for rows in stretches(time, time))
        lost = 2 * reach(min(bands)) + lateness
        raise ValueError(
            "no stretch without a gap is long enough: the longest piece of the record has "
            f"{longest:.3g} s, of which smoothing and delays need {lost:.3g} "
            "s at its ends; give a longer or less noisy record."
        )
    equation = np.repeat(np.arange(len(base)), [len(rows) for rows in filtered])
    return Rows(equation, columns[:, 0], columns[:, 1], columns[:, 2:]), bands


def acting(time: Array, values: Array) -> Array:
    """Return a held input (n,) as it acts on a smooth curve through the driven state.

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
            result[rows] = make_interp_spline(t, course, k=order)(np.clip(t - late, t[0], t[-1]))
    return result
