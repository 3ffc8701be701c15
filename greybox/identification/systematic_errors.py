"""Errors of a response that its scatter does not show: passes of the loop that were not logged, and rounded outputs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record, Recording
from greybox.data.test_segment import Segment
from greybox.files.arrays import Array
from greybox.logs.ardupilot.loop_rate import thinning, thinning_error
from greybox.logs.ardupilot.motors import motor_outputs, pwm_of_control, rounding_error, saturation
from greybox.logs.flight_controllers import axis_of
from greybox.spectral.test_quality import SATURATED, Finding

Complex = NDArray[np.complexfloating]

# Of the response: an error that is smaller everywhere is not worth a word. A tenth of what sine
# tests of ten periods state, 0.2 to 1 %.
WORTH_A_WORD = 1e-3

# PWM steps, the amplitude below which the gain may be anything from zero to twice its value.
ONE_STEP = 1.0


@dataclass(frozen=True, eq=False)
class SystematicError:
    """One error: what it is of, its standard deviation relative to the response (n,), and what is found.

    `common` (m, n) has it point by point, relative to the response, where all points have it in
    common.
    """

    about: str
    relative: Array
    finding: Finding
    common: Complex | None = None


def systematic_errors(
    recording: Recording,
    record: Record,
    response: FrequencyResponse,
    control: str,
    used: Sequence[Segment],
    amplitudes: Array | None = None,
) -> list[SystematicError]:
    """Return the errors of a response from a control that the log tells of.

    Parameters
    ----------
    recording : Recording
        With the parameters of the vehicle.
    record : Record
        What was used, with the control by the name that it has in the response.
    response : FrequencyResponse
    control : str
        The signal of the log, ``"RATE.POut"``.
    used : sequence of Segment
        The tests; none for the whole record.
    amplitudes : (n,) array, optional
        Of the control at every frequency, where they are known: of sines. By default that of its
        whole motion.
    """
    axis = axis_of(control)
    if not axis:
        return []
    spans = [(s.start, s.end) for s in used] or [(float(record.time[0]), float(record.time[-1]))]
    found = [
        _thinned(recording, response, control, axis, spans),
        _rounded(recording, record, response, used, spans, amplitudes),
    ]
    return [error for error in found if error is not None and error.relative.max() > WORTH_A_WORD]


def with_systematic_errors(
    response: FrequencyResponse, errors: Sequence[SystematicError]
) -> FrequencyResponse:
    """Return the response with the errors in its variance; its degrees of freedom become those of the sum.

    Errors of known size have no uncertainty of their own, so that the sum has the more degrees of
    freedom the larger they are (Welch and Satterthwaite).
    """
    if response.variance is None or not errors:
        return response
    added = np.sum([error.relative**2 for error in errors], axis=0) * np.abs(response.response) ** 2
    total = response.variance + added
    dof = None if response.dof is None else response.dof * (total / response.variance) ** 2
    about = {
        error.about: _size(error.relative) + " of the response, in its variance" for error in errors
    }
    common = [error.common * response.response for error in errors if error.common is not None]
    return replace(
        response,
        variance=total,
        dof=dof,
        about={**response.about, **about},
        common_errors=np.vstack(common) if common else None,
    )


def motor_saturation(
    recording: Recording, control: str, spans: Sequence[tuple[float, float]]
) -> list[Finding]:
    """Judge how long a motor was at its limit, where the log has the outputs of the motors."""
    share = saturation(recording, spans) if axis_of(control) else math.nan
    if not share > SATURATED[0]:
        return []
    text = f"a motor is at its limit for {100 * share:.0f} % of the time: a linear model is wrong there"
    return [
        Finding(
            "motors",
            "refusal" if share > SATURATED[1] else "warning",
            share,
            f"{text}; use a smaller amplitude.",
        )
    ]


def _thinned(
    recording: Recording,
    response: FrequencyResponse,
    control: str,
    axis: str,
    spans: Sequence[tuple[float, float]],
) -> SystematicError | None:
    found = thinning(
        recording, control, min(start for start, _ in spans), max(end for _, end in spans)
    )
    if found is None:
        return None
    common = thinning_error(found, recording, axis, response)
    relative = np.linalg.norm(common, axis=0)
    text = (
        f"{found}: {_size(relative)} are added to the standard errors, as an error that all frequencies have in common "
        f"and a fitted gain has too; to log every pass, {found.cure}."
    )
    return SystematicError(
        "thinned log", relative, Finding("logging", "note", float(relative.max()), text), common
    )


def _rounded(
    recording: Recording,
    record: Record,
    response: FrequencyResponse,
    used: Sequence[Segment],
    spans: Sequence[tuple[float, float]],
    amplitudes: Array | None,
) -> SystematicError | None:
    steps = pwm_of_control(recording.metadata.get("parameters", {}))
    if math.isnan(steps):
        return None
    pieces = [record.between(*span)[response.input] for span in spans]
    motion = np.array([_motion(recording, steps, *one) for one in zip(pieces, spans, strict=True)])
    if amplitudes is None:
        a = np.full(
            len(response), steps * np.sqrt(2) * max(float(np.std(values)) for values in pieces)
        )
        moved = np.full(len(response), motion.min())
    else:
        a = steps * amplitudes
        moved = motion[
            [int(np.argmin([abs(s.omega - omega) for s in used])) for omega in response.omega]
        ]
    relative = rounding_error(a, np.sqrt(np.maximum(moved**2 - a**2 / 2, 0)))
    below = response.omega[(a < ONE_STEP) & (relative > WORTH_A_WORD)]
    text = f"motor outputs are whole µs: {_size(relative)} are added to the standard errors"
    if below.size:
        places = ", ".join(f"{omega:.3g}" for omega in below)
        text += f", as the control is below one step at {places} rad/s; excite more there"
    severity = "warning" if below.size else "note"
    return SystematicError(
        "rounded outputs", relative, Finding("resolution", severity, float(a.min()), f"{text}.")
    )


def _motion(recording: Recording, steps: float, control: Array, span: tuple[float, float]) -> float:
    """Return the standard deviation of the quietest motor, steps: as logged, and no less than the control moves it."""
    by_control = steps * float(np.std(control))
    outputs = motor_outputs(recording, *span)
    logged = () if outputs is None else outputs.signals.values()
    return max(by_control, min((float(np.std(values)) for values in logged), default=0.0))


def _size(relative: Array) -> str:
    low, high = 100 * float(relative.min()), 100 * float(relative.max())
    if low < 0.1 * high:
        return f"up to {high:.2g} %"
    return f"{high:.2g} %" if high < 1.1 * low else f"{low:.2g} to {high:.2g} %"
