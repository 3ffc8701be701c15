"""A matrix of responses from multisines on several inputs at once, each with lines of its own.

Where the inputs are coupled, by a mixer or a controller, every input has something of every line:
the ratio of an output and an input at a line is then no response. But what one input does at the
lines of another follows from its response at its own lines, between which responses are smooth. So
the outputs at all lines together are one linear system for all responses at their own lines.
"""

from collections.abc import Sequence

import numpy as np

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.files.arrays import Array, ComplexArray
from greybox.files.text_table import counted
from greybox.spectral.multisine_lines import EXCITED, whole_periods
from greybox.spectral.uniform_stretches import uniform_stretches

# Condition number of that system, with rows and columns of length one, from which the inputs cannot
# be told apart: an error of a thousandth in the inputs is then one of a tenth in the responses.
TOO_ALIKE = 100.0


def response_matrix(
    records: Record | Sequence[Record],
    period: float,
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    excitations: Sequence[str] = (),
    name: str = "",
) -> tuple[FrequencyResponse, ...]:
    """Estimate the responses of all outputs to all inputs, each at the lines of its input, cross-coupling removed.

    The signals are averaged over the periods, of which the first must be left out while the plant
    settles; variances come from the scatter of the periods (jackknife).

    Parameters
    ----------
    records : Record or sequence of Record
    period : float, s
        A whole number of samples.
    inputs, outputs : sequence of str
    excitations : sequence of str
        The injected signals, one for each input, by which the lines are assigned; by default the
        inputs themselves.
    name : str

    Returns
    -------
    tuple of FrequencyResponse
        Output by output, for each the inputs in turn. `greybox.data.write_responses` keeps them in
        one file, `greybox.plotting.response_matrix` draws them.

    Raises
    ------
    ValueError
        If there are fewer than three whole periods, an input has fewer than two lines of its own,
        or the inputs are so much alike that their effects cannot be told apart.

    Notes
    -----
    Pintelon and Schoukens, System Identification, 2nd ed., section 2.7 (orthogonal multisines);
    Morelli and Klein, Aircraft System Identification, 2nd ed., section 9.5.
    """
    inputs, outputs, excitations = (
        tuple(inputs),
        tuple(outputs),
        tuple(excitations) or tuple(inputs),
    )
    if len(excitations) != len(inputs):
        raise ValueError(
            f"there are {len(excitations)} excitations for {len(inputs)} inputs: give one for each."
        )
    stretches = [
        whole_periods(s, period)
        for s in uniform_stretches(records, (*inputs, *outputs, *excitations), "none")
    ]
    stretches = [s for s in stretches if s.values.shape[1]]
    periods = [
        np.split(s.values, round(s.values.shape[1] * s.step / period), axis=1) for s in stretches
    ]
    every = np.array([np.fft.rfft(one, axis=1)[:, 1:-1] for each in periods for one in each])
    if len(every) < 3:
        raise ValueError(
            f"the records hold {counted(len(every), 'whole period')} of {period:g} s, and a variance needs the scatter "
            "of three at least: record longer."
        )
    omega = 2 * np.pi / period * np.arange(1, every.shape[2] + 1)
    m, k = len(inputs), len(outputs)
    size = np.abs(every[:, m + k :].mean(axis=0))
    relative = size / size.max(axis=1, keepdims=True)
    owner = np.where(relative.max(axis=0) > EXCITED, relative.argmax(axis=0), -1)
    lines = np.flatnonzero(owner >= 0)
    own = [np.flatnonzero(owner[lines] == j) for j in range(m)]
    for j, rows in enumerate(own):
        if rows.size < 2:
            raise ValueError(
                f"{inputs[j]} has {counted(rows.size, 'line')} of its own, and a response between lines needs two at "
                "least: give every input a multisine of its own, gb.experiment.multisine(signals=[...])."
            )
    between = [_interpolation(omega[lines[rows]], omega[lines]) for rows in own]
    total = every[:, :, lines].sum(axis=0)
    means = [total / len(every), *((total - one[:, lines]) / (len(every) - 1) for one in every)]
    solved = np.array([_solved(mean[:m], mean[m : m + k], between) for mean in means])
    left_out = solved[1:]
    variance = (len(every) - 1) * np.mean(np.abs(left_out - left_out.mean(axis=0)) ** 2, axis=0)
    begins = np.concatenate([[0], np.cumsum([rows.size for rows in own])])
    units = {key: unit for s in stretches for key, unit in s.units.items() if unit}
    return tuple(
        FrequencyResponse(
            omega[lines[own[j]]],
            solved[0, begins[j] : begins[j + 1], i],
            inputs[j],
            outputs[i],
            variance=np.maximum(
                variance[begins[j] : begins[j + 1], i], np.finfo(float).tiny ** 0.5
            ),
            dof=np.full(own[j].size, 2.0 * (len(every) - 1)),
            name=f"{name} {inputs[j]} to {outputs[i]}".strip(),
            source=stretches[0].source,
            stretches=[s.origin for s in stretches if s.origin is not None],
            units={key: units[key] for key in (inputs[j], outputs[i]) if key in units},
        )
        for i in range(k)
        for j in range(m)
    )


def _interpolation(own: Array, wanted: Array) -> Array:
    """Return the matrix (wanted, own) of the cubic spline over log ω; beyond its ends the value there."""
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415  (takes a fifth of a second to import)

    spline = make_interp_spline(np.log(own), np.eye(own.size), k=min(3, own.size - 1))
    return np.asarray(spline(np.log(np.clip(wanted, own[0], own[-1]))))


def _solved(inputs: ComplexArray, outputs: ComplexArray, between: Sequence[Array]) -> ComplexArray:
    """Return the responses (own lines of all inputs, outputs) from inputs (m, lines) and outputs (k, lines)."""
    system = np.concatenate(
        [u[:, None] * way for u, way in zip(inputs, between, strict=True)], axis=1
    )
    rows = np.linalg.norm(system, axis=1, keepdims=True)
    columns = np.linalg.norm(system / rows, axis=0)
    scaled = system / rows / columns
    condition = np.linalg.cond(scaled)
    if not condition < TOO_ALIKE:
        raise ValueError(
            f"the inputs have so much of each other's lines (condition number {condition:.3g}) that their effects "
            "cannot be told apart: excite each more, or fewer at once."
        )
    return np.linalg.solve(scaled, outputs.T / rows) / columns[:, None]
