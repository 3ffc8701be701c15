"""From multisines on several inputs at once to the matrix of responses, with what was chosen."""

import math
from collections.abc import Sequence

import numpy as np

from greybox.data.files.arrays import Interval
from greybox.data.files.frozen_values import frozen
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import one_line
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import counted
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.logs.prepare import prepare
from greybox.data.record import Record, Recording
from greybox.data.spectral.orthogonal_multisines import response_matrix
from greybox.workflows.identification.logged_faults import repaired
from greybox.workflows.identification.loop import controller_in, loop_text
from greybox.workflows.identification.measurement import named_signals

SETTLED = 2.0  # s, as long as sines settle by default


@public
@frozen
class MatrixMeasurement:
    """The measurement of several inputs at once.

    Attributes
    ----------
    record : Record
        The signals on one time base, cut to the test.
    responses : tuple of FrequencyResponse
        Output by output, for each the inputs in turn.
    choices : tuple of str
        What was chosen and why, in sentences.
    """

    record: Record
    responses: tuple[FrequencyResponse, ...]
    choices: tuple[str, ...]

    def __repr__(self) -> str:
        return one_line(self, counted(len(self.responses), "response"))

    def __str__(self) -> str:
        header = ("output", "input", "points", "from rad/s", "to rad/s", "error %")
        return "\n".join(
            [text_table(header, [_row(r) for r in self.responses], left=(0, 1)), "", *self.choices]
        )


@public
def measure_matrix(
    recording: Recording,
    inputs: Sequence[str],
    outputs: Sequence[str],
    period: float,
    *,
    excitations: Sequence[str] = (),
    rate: float | None = None,
    band: Interval | None = None,
    settle: float = SETTLED,
) -> MatrixMeasurement:
    """Return the responses of all outputs to all inputs; every input has a multisine.

    Parameters
    ----------
    recording : Recording
    inputs, outputs : sequence of str
        ``"MESSAGE.Field"``, or with names of one's own ``"u=RATE.POut"``.
    period : float, s
        Period of the multisines.
    excitations : sequence of str
        The injected signals, one for each input: the test is where they move, and the lines of each
        input are those of its excitation. By default the inputs, of the whole log.
    rate : float, Hz, optional
        By default that of the slowest signal, or a little less, so that a period is a whole number
        of samples.
    band : (low, high), rad/s, optional
    settle : float, s
        Left out at the beginning of the test, at least.

    Raises
    ------
    ValueError, KeyError
        For signals that are not there or damaged throughout, see `greybox.data.signal_faults`, and
        for what `greybox.spectral.response_matrix` refuses.
    """
    injected = [f"excitation {k}={signal}" for k, signal in enumerate(excitations, start=1)]
    signals = named_signals((*inputs, *outputs, *injected))
    u, y, e = (list(named_signals(texts)) for texts in (inputs, outputs, injected))
    record = prepare(recording, signals, rate)
    log = repaired(recording, named_signals(outputs), named_signals(inputs), record.span)
    if log.remaining:
        raise ValueError(str(log.remaining[0]))
    if log.removed:
        recording = log.recording
        record = prepare(recording, signals, rate)
    # A period of a fraction of a sample would leak from line to line.
    if rate is None and period * record.rate >= 2:
        record = prepare(recording, signals, math.floor(period * record.rate * (1 + 1e-9)) / period)
    # The excitations show the test; inputs in a loop move before and after it.
    start, end = _moving(record, e) if e else record.span
    record = record.between(start + settle, end)
    responses = response_matrix(record, period, u, y, excitations=e, name=record.name)
    if band is not None:
        responses = tuple(response.between(*band) for response in responses)
    used = math.floor((len(record) / record.rate) / period + 1e-9)
    choices = [
        f"from {record.time[0]:.2f} to {record.time[-1]:.2f} s at {record.rate:.5g} Hz: "
        f"{counted(used, 'period')} of {period:g} s, after {settle:g} s of settling."
    ]
    choices += [finding.text for finding in log.findings]
    measured = [signals[name] for name in (*u, *y)]
    loop = loop_text(controller_in(recording, measured[: len(u)], measured))
    by = f"the excitations {', '.join(excitations)}" if e else "the inputs themselves"
    choices.append(
        f"{loop}: averages over whole periods, at the frequencies of {by}. To name other "
        "excitations, give instrument=..."
    )
    return MatrixMeasurement(record, responses, tuple(choices))


def _moving(record: Record, names: Sequence[str]) -> Interval:
    """Return from when to when a signal moves."""
    steps = np.array([np.diff(record[name]) for name in names])
    # Above rounding: a logged zero may be a small number.
    limit = 1e-9 * np.maximum(np.ptp([record[name] for name in names], axis=1), 1e-300)[:, None]
    moves = np.flatnonzero((np.abs(steps) > limit).any(axis=0))
    if not moves.size:
        raise ValueError(
            "no excitation moves in the log: name the injected signals, one for each input."
        )
    return float(record.time[moves[0]]), float(record.time[moves[-1] + 1])


def _row(response: FrequencyResponse) -> tuple[str, ...]:
    error = float(np.median(response.relative_error))
    ends = (number(float(response.omega[0]), 4), number(float(response.omega[-1]), 4))
    return (response.output, response.input, str(len(response)), *ends, number(100 * error, 2))
