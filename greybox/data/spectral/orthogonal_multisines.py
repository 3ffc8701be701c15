"""A matrix of responses from multisines on several inputs at once, each with lines of its own.

If a mixer or a controller couples the inputs, every input contains all lines, and the ratio of an
output and an input at a line is not a response. But responses are smooth, so the effect of an input
at the lines of another follows by interpolation from its response at its own lines. The outputs at
all lines are therefore one linear system for all responses, each at its own lines.
"""

from collections.abc import Sequence

import numpy as np

from greybox.data.files.arrays import Array, ComplexArray
from greybox.data.files.public import public
from greybox.data.files.wording import counted
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.data.spectral.estimated_points import measured_in
from greybox.data.spectral.multisine_lines import EXCITED, period_spectra


@public
def response_matrix(
    records: Record | Sequence[Record],
    period: float,
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    excitations: Sequence[str] = (),
    name: str = "",
) -> tuple[FrequencyResponse, ...]:
    """Estimate the responses of all outputs to all inputs, without cross-coupling.

    Each response is estimated at the lines of its input. The signals are averaged over the periods
    (cut off those in which the plant settles); variances come from their scatter (jackknife).

    Parameters
    ----------
    records : Record or sequence of Record
    period : float, s
        A whole number of samples.
    inputs, outputs : sequence of str
    excitations : sequence of str
        The injected signals, one for each input, which assign the lines; by default the inputs.
    name : str

    Returns
    -------
    tuple of FrequencyResponse
        By output, then by input. `greybox.data.write_responses` writes them to one file,
        `greybox.reporting.plotting.bode` draws them.

    Raises
    ------
    ValueError
        If there are fewer than three whole periods, an input has fewer than two lines of its own,
        or the inputs are so similar that their effects cannot be separated.

    Notes
    -----
    Pintelon and Schoukens, System Identification, 2nd ed., section 2.7 (orthogonal multisines);
    Morelli and Klein, Aircraft System Identification, 2nd ed., section 9.5.
    """
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415  (slow import)

    excitations = excitations or inputs
    if len(excitations) != len(inputs):
        raise ValueError(
            f"there are {len(excitations)} excitations for {len(inputs)} inputs: give one for each."
        )
    stretches, spectra = period_spectra(records, period, (*inputs, *outputs, *excitations))
    omega = 2 * np.pi / period * np.arange(1, spectra.shape[2] + 1)
    m, k = len(inputs), len(outputs)

    # A line belongs to the excitation that is strongest there. Their units may differ, so each is
    # compared with its own largest line.
    size = np.abs(spectra[:, m + k :].mean(axis=0))
    relative = size / size.max(axis=1, keepdims=True)
    owner = np.where(relative.max(axis=0) > EXCITED, relative.argmax(axis=0), -1)
    lines = np.flatnonzero(owner >= 0)
    rows_of = [np.flatnonzero(owner[lines] == j) for j in range(m)]
    for j, rows in enumerate(rows_of):
        if rows.size < 2:
            raise ValueError(
                f"{inputs[j]} has {counted(rows.size, 'line')} of its own, and interpolation needs "
                "at least two: excite every input with its own multisine, "
                "gb.experiment.multisine(signals=[...])."
            )

    # A cubic spline over log ω, constant beyond its ends, as a matrix for each input.
    between = []
    for rows in rows_of:
        own = omega[lines[rows]]
        spline = make_interp_spline(np.log(own), np.eye(own.size), k=min(3, own.size - 1))
        between.append(spline(np.log(np.clip(omega[lines], own[0], own[-1]))))
    total = spectra[:, :, lines].sum(axis=0)
    # The sum over all periods, and for the jackknife the sums without one of them: a factor on
    # inputs and outputs does not change the responses.
    count = len(spectra)
    sums = [total, *(total - p[:, lines] for p in spectra)]
    solved = np.array([_solved(x[:m], x[m : m + k], between) for x in sums])
    jackknife = solved[1:]
    variance = (count - 1) * np.mean(np.abs(jackknife - jackknife.mean(axis=0)) ** 2, axis=0)

    # The unknowns are the responses of the first input at its lines, then those of the second ...
    ends = np.cumsum([rows.size for rows in rows_of])[:-1]
    responses, variances = np.split(solved[0], ends), np.split(variance, ends)
    return tuple(
        FrequencyResponse(
            omega[lines[rows_of[j]]],
            responses[j][:, i],
            inputs[j],
            outputs[i],
            variance=np.maximum(variances[j][:, i], np.finfo(float).tiny ** 0.5),
            dof=np.full(rows_of[j].size, 2.0 * (count - 1)),
            name=f"{name} {inputs[j]} to {outputs[i]}".strip(),
            **measured_in(stretches, inputs[j], outputs[i]),
        )
        for i in range(k)
        for j in range(m)
    )


def _solved(inputs: ComplexArray, outputs: ComplexArray, between: Sequence[Array]) -> ComplexArray:
    """Return the responses (lines, outputs) from inputs (m, lines) and outputs (k, lines)."""
    system = np.hstack([u[:, None] * matrix for u, matrix in zip(inputs, between, strict=True)])
    # Inputs have different units and lines different amplitudes, which would decide the condition
    # number without scaling.
    rows = np.linalg.norm(system, axis=1, keepdims=True)
    columns = np.linalg.norm(system / rows, axis=0)
    scaled = system / rows / columns
    condition = np.linalg.cond(scaled)
    # With rows and columns of length one, an error of 0.1 % in the inputs then becomes 10 % in the
    # responses: the effects of the inputs cannot be separated.
    if not condition < 100.0:
        raise ValueError(
            f"the inputs share their lines so much (condition number {condition:.3g}) that their "
            "effects cannot be separated: excite each input more, or fewer at once."
        )
    return np.linalg.solve(scaled, outputs.T / rows) / columns[:, None]
