"""Errors of a response that its scatter does not show: thinned logs, rounded motors, few decimals.

Begin with `systematic_errors`; `truncation_error` is that of outputs that were logged in steps, and
`hold_error` that of inputs whose hold is not stated.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from greybox.data.excited_segment import Segments
from greybox.data.files.arrays import Array, ComplexArray, Interval, real_root
from greybox.data.files.frozen_values import frozen
from greybox.data.files.numbers_in_text import number
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.intersample import HOLD_IN_ERRORS, UNSTATED_HOLD, response_of_hold
from greybox.data.logs.ardupilot.motors import (
    motor_outputs,
    pwm_of_control,
    rounding_error,
    saturation,
)
from greybox.data.logs.ardupilot.truncated_angles import is_truncated
from greybox.data.logs.flight_controllers import axis_of
from greybox.data.logs.loop_rate import thinning, thinning_error
from greybox.data.record import Record, Recording
from greybox.data.spectral.experiment_quality import SATURATED, Finding, frequencies, graded

# An error that is a smaller share of the response everywhere is not mentioned: a tenth of the
# standard errors of sine tests of ten periods, 0.2 to 1 %.
NEGLIGIBLE = 1e-3
# Step over the standard deviation of an output, below which motions of a thirtieth of it lose less.
FINE = 1e-4


@frozen
class SystematicError:
    """An error of a response.

    Attributes
    ----------
    about : str
        Its cause.
    relative : (n,) array
        Its standard deviation relative to the response.
    finding : Finding
    common : (m, n) complex array or None
        The error itself, relative to the response, if all points have it in common.
    """

    about: str
    relative: Array
    finding: Finding
    common: ComplexArray | None = None


def systematic_errors(
    recording: Recording,
    record: Record,
    response: FrequencyResponse,
    control: str,
    used: Segments,
    amplitudes: Array | None = None,
) -> list[SystematicError]:
    """Return the errors of a response from a control that follow from the log.

    Parameters
    ----------
    recording : Recording
        With the parameters of the vehicle.
    record : Record
        The signals that were used, the control by its name in the response.
    response : FrequencyResponse
    control : str
        The signal of the log, ``"RATE.POut"``.
    used : sequence of Segment
        The tests; empty for the whole record.
    amplitudes : (n,) array, optional
        Amplitudes of the control at every frequency, for sines. By default, the amplitude of its
        whole motion.
    """
    axis = axis_of(control)
    # Only the logs of known controllers say how their outputs were thinned and rounded.
    if not axis:
        return []
    spans = [(s.start, s.end) for s in used] or [record.span]
    errors = [
        _error_of_thinning(recording, response, control, axis, spans),
        _error_of_rounding(recording, record, response, used, spans, amplitudes),
    ]
    noticeable = []
    for error in errors:
        if error is None:
            continue
        if error.relative.max() > NEGLIGIBLE or error.finding.severity == "warning":
            noticeable.append(error)
    return noticeable


def truncation_error(
    recording: Recording,
    record: Record,
    response: FrequencyResponse,
    output: str,
    estimate: Callable[[Record], FrequencyResponse],
) -> list[SystematicError]:
    """Return the error of a response whose output may have been truncated by its log, if it counts.

    Truncation toward zero subtracts half a step with the sign of the output, and so takes 2 q/(π A)
    off a sine of amplitude A in steps of q, and more off the small motions of a sweep; rounding
    takes nothing. No log says which. So the response is estimated again with these halves added,
    and the error is taken as uniform between both. An output that keeps its sign is only shifted.

    Parameters
    ----------
    recording : Recording
    record : Record
        The signals that were used.
    response : FrequencyResponse
    output : str
        The output in the log, ``"ATT.Pitch"``.
    estimate : function
        Returns the response of a record, as `response` was estimated.
    """
    values = record[response.output]
    raw, name = recording.locate(output)
    logged = raw.between(*record.span)[name]
    levels = np.unique(logged[np.isfinite(logged)])
    # What ArduPilot truncated, `prepare` has mended.
    if levels.size < 2 or not levels[0] < 0 < levels[-1] or is_truncated(output, logged):
        return []

    q = float(np.diff(levels).min() * np.nanstd(values) / np.nanstd(logged))
    if q < FINE * np.nanstd(values):
        return []

    mended = values + q / 2 * np.sign(values)
    whole = estimate(replace(record, signals={**record.signals, response.output: mended}))
    # Both may have frequencies of their own: logarithms change slowly between them.
    mended_log, logged_log = (
        np.log(np.abs(r.response)) + 1j * np.unwrap(np.angle(r.response)) for r in (whole, response)
    )
    change = np.interp(response.omega, whole.omega, mended_log) - logged_log
    error: ComplexArray = np.asarray(np.expm1(change) / math.sqrt(3), dtype=complex)
    relative = np.abs(error)
    if relative.max() <= NEGLIGIBLE:
        return []

    text = (
        f"{response.output} is logged in steps of {number(q, 2)}, and may be truncated: "
        f"{_size(relative)} are added to the standard errors, as an error that all frequencies and "
        "a fitted gain have in common; larger motions, or a log of more decimals, have less."
    )
    finding = Finding("decimals", "note", float(relative.max()), text)
    return [SystematicError("truncated output", relative, finding, error[None])]


def hold_error(response: FrequencyResponse) -> list[SystematicError]:
    """Return the error of a hold of the input that the log does not state, if it counts.

    A held input makes the response later by about half a sample, an interpolated one does not. As
    no log says which, the deviation is that of both being as likely, about none.
    """
    step = float(response.about.get(UNSTATED_HOLD, math.nan))
    if not math.isfinite(step):
        return []
    error = (response_of_hold(response.omega, step) - 1) / math.sqrt(2)
    relative = np.abs(error)
    if relative.max() <= NEGLIGIBLE:
        return []
    text = (
        f"the log does not state whether {response.input or 'the input'} is held between its "
        f"samples: {_size(relative)} are added to the standard errors, as an error that all "
        f"frequencies and a fitted delay, up to {number(500 * step, 2)} ms, have in common; state "
        "it to remove them."
    )
    finding = Finding("hold", "note", float(relative.max()), text)
    return [SystematicError(HOLD_IN_ERRORS, relative, finding, error[None])]


def with_systematic_errors(
    response: FrequencyResponse, errors: Sequence[SystematicError]
) -> FrequencyResponse:
    """Return the response with the errors added to its variance.

    The size of these errors is known, so the sum has more degrees of freedom (Welch and
    Satterthwaite).
    """
    errors = [error for error in errors if error.relative.any()]
    if response.variance is None or not errors:
        return response
    # Errors of different causes are independent, so that their variances add.
    added = np.sum([error.relative**2 for error in errors], axis=0) * np.abs(response.response) ** 2
    total = response.variance + added
    dof = None if response.dof is None else response.dof * (total / response.variance) ** 2
    about = {}
    common = []
    for error in errors:
        about[error.about] = f"{_size(error.relative)} of the response, in its variance"
        if error.common is not None:
            common.append(error.common * response.response)
    return replace(
        response,
        variance=total,
        dof=dof,
        about={**response.about, **about},
        common_errors=np.vstack(common) if common else None,
    )


def motor_saturation(
    recording: Recording, control: str, spans: Sequence[Interval]
) -> list[Finding]:
    """Return a finding if a motor was at its limit for long, from the motor outputs in the log."""
    share = saturation(recording, spans) if axis_of(control) else math.nan
    text = (
        f"a motor is at its limit for {100 * share:.0f} % of the time: a linear model is wrong "
        "there; use a smaller amplitude."
    )
    return [*graded("motors", share, SATURATED, text)]


def _error_of_thinning(
    recording: Recording,
    response: FrequencyResponse,
    control: str,
    axis: str,
    spans: Sequence[Interval],
) -> SystematicError | None:
    """Return the error of a log that has only some of the passes of a loop; None if it has all."""
    # The rate of a log may change between flights: only that during the tests counts.
    begin = min(start for start, _ in spans)
    end = max(end for _, end in spans)
    thinned = thinning(recording, control, begin, end)
    if thinned is None:
        return None
    if math.isnan(thinned.count):
        text = (
            f"{thinned}: noise and steps of the control alias into the band, so that the gain "
            "depends on which passes were logged, often by some percent that the standard errors "
            f"do not show; to log every pass, {thinned.cure}."
        )
        return SystematicError(
            "thinned log",
            np.zeros(len(response)),
            Finding("logging", "warning", thinned.logged, text),
        )
    common = thinning_error(thinned, recording, axis, response)
    relative = np.linalg.norm(common, axis=0)
    text = (
        f"{thinned}: {_size(relative)} are added to the standard errors, as an error that all "
        f"frequencies and a fitted gain have in common; to log every pass, {thinned.cure}."
    )
    return SystematicError(
        "thinned log", relative, Finding("logging", "note", float(relative.max()), text), common
    )


def _error_of_rounding(
    recording: Recording,
    record: Record,
    response: FrequencyResponse,
    used: Segments,
    spans: Sequence[Interval],
    amplitudes: Array | None,
) -> SystematicError | None:
    """Return the error of motor outputs in whole steps of PWM; None if these are not known."""
    steps = pwm_of_control(recording.parameters)
    if math.isnan(steps):
        return None
    controls = [record.between(*span)[response.input] for span in spans]
    # Rounding acts like noise where other motion moves a motor over several steps. Where the motor
    # would otherwise stand still, it distorts the control.
    motions = []
    for control, span in zip(controls, spans, strict=True):
        motions.append(_motion(recording, steps, control, span))
    # Amplitudes of the control, and standard deviations of the motion, in steps at each frequency.
    if amplitudes is None:
        # The loudest piece has most of the weight in the estimate.
        loudest = max(float(np.std(values)) for values in controls)
        amplitude = np.full(len(response), steps * np.sqrt(2) * loudest)
        motion = np.full(len(response), min(motions))
    else:
        amplitude = steps * amplitudes
        test_of_point = [
            np.argmin([abs(segment.omega - omega) for segment in used]) for omega in response.omega
        ]
        motion = np.array(motions)[test_of_point]
    # The sine itself is part of the motion. Its variance, a²/2, is subtracted.
    relative = rounding_error(amplitude, real_root(motion**2 - amplitude**2 / 2))
    # Below one step, the error is no longer small noise: the finding names these points.
    below = response.omega[(amplitude < 1.0) & (relative > NEGLIGIBLE)]
    text = f"motor outputs are whole µs: {_size(relative)} are added to the standard errors"
    if below.size:
        text += f", as the control is below one step at {frequencies(below)}; excite more there"
    severity = "warning" if below.size else "note"
    smallest = float(amplitude.min())
    finding = Finding("resolution", severity, smallest, f"{text}.", tuple(below.tolist()))
    return SystematicError("rounded outputs", relative, finding)


def _motion(recording: Recording, steps: float, control: Array, span: Interval) -> float:
    """Return the standard deviation of the quietest motor in steps, at least that of the control.

    If the log has no motor outputs, it is that of the control.
    """
    by_control = steps * float(np.std(control))
    start, end = span
    deviations = [float(np.std(values)) for values in motor_outputs(recording, start, end).values()]
    return max(by_control, min(deviations, default=0.0))


def _size(relative: Array) -> str:
    """Return the range of relative errors in percent, as text."""
    low = 100 * float(relative.min())
    high = 100 * float(relative.max())
    if low < 0.1 * high:
        return f"up to {high:.2g} %"
    return f"{high:.2g} %" if high < 1.1 * low else f"{low:.2g} to {high:.2g} %"
