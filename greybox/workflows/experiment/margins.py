"""Margins and closed-loop numbers of a plant with its controllers, with their errors.

Begin with `margins`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from greybox.assessment.fitted_part import FittedResponse
from greybox.assessment.response_band import require_level
from greybox.assessment.result import Fit
from greybox.data.files.arrays import Array
from greybox.data.files.named_values import Values
from greybox.data.files.public import public
from greybox.data.files.wording import listed
from greybox.data.frequency_band import number_pair
from greybox.data.frequency_response import FrequencyResponse
from greybox.modeling.model import Model
from greybox.workflows.experiment.closed_loop import (
    closed_loop_numbers,
    follows,
    setpoint_and_response,
)
from greybox.workflows.experiment.controller import Controller, Controllers
from greybox.workflows.experiment.drawn_loops import BESIDE, DRAWN, drawn_loops
from greybox.workflows.experiment.loop_numbers import (
    LoopNumbers,
    loop_frequencies,
    margin_numbers,
    refined,
)
from greybox.workflows.experiment.margin_values import ORDER, UNITS, Margin, Margins
from greybox.workflows.experiment.measured_loop_margins import measured_margins
from greybox.workflows.experiment.sampled_loop import DOT

_INTEGRALS = {"rad": 0, "deg": 0, "rad/s": 1, "deg/s": 1}  # from a response to an attitude


@public
def margins(  # noqa: PLR0913  (what is in the loop, and where to break it)
    plant: Fit | Model | FrequencyResponse,
    controller: Controllers | None = None,
    values: Values | None = None,
    *,
    broken_at: str = "",
    tracking: tuple[str, str] | None = None,
    at: Values | None = None,
    part: int = 0,
    level: float = 0.95,
    boundary: Sequence[tuple[float, float]] = (),
) -> Margins:
    """Return margins and closed-loop numbers of a plant with sampled controllers, with intervals.

    The loop is that of `virtual_flight`: the controllers run at their rate, the control is held
    until the next sample, and the delay of the plant is exact. The first group of numbers describes
    the loop broken at one signal, with every other loop closed:

    - *phase margin*: the smallest phase, lag or lead, that makes the loop unstable, in degrees;
    - *gain margin* and *gain reduction margin*: the smallest factors above and below one that do,
      at rest and at the Nyquist frequency, too;
    - *delay margin*: the smallest additional delay that does; near a fifth of the rate of the loop
      and above it, a delay of a fraction of a sample changes the gain, too, which is not counted;
    - *modulus margin*: the smallest distance of the loop gain from -1, the inverse of the peak of
      the sensitivity;
    - *crossover*: the highest frequency at which the gain is one;
    - *disturbance rejection bandwidth* and *peak*: where the sensitivity first reaches -3 dB, and
      its largest value;
    - *phase margin 1*, *gain margin 1* ...: at every crossing, if there are several, from the
      lowest frequency up; gain margins within 40 dB, negative for a reduction.

    The second group describes the response to a setpoint, over its value at rest:

    - *bandwidth*: the highest frequency at which it is within 3 dB; *-180 deg frequency*;
    - *ADS-33 gain*, *phase bandwidth* and *phase delay* of the attitude, if the unit of the
      response is that of an angle or of a rate (whose integral is taken), at samples of the
      controller, and *ADS-33 bandwidth*: the smaller one where a rate is commanded, that of the
      phase where an attitude is; *bandwidth above the boundary* is positive inside `boundary`;
    - *overshoot*, *rise time* from 10 % to 90 % and *settling time* to 2 % of a step;
    - *damping ratio* and *natural frequency* of the poles with the largest part in that step.

    The intervals are quantiles over draws from the distribution of the estimates, so they need not
    be symmetric. The draws have Student's t distribution with the covariance of the fit, within the
    bounds of the parameters; of fits of frequency responses, every draw is moved until its
    likelihood agrees with its distance (Chandler and Bate), so that the intervals follow the
    profiles. The intervals cover the errors of the parameters, but not effects that the model
    lacks, such as structural modes. If more than ``(1 - level) / 2`` of the draws are unstable,
    their share is the answer.

    Parameters
    ----------
    plant : Fit, Model or FrequencyResponse
        A model has no errors, and its margins no intervals. A measured response is the gain of the
        broken loop, as `greybox.experiment.broken_loop` makes it; its margins need no
        model and no controller: see `greybox.experiment.measured_margins`.
    controller : Controller or several
        With the gains that fly. The outputs of one may be the setpoints of the next.
    values : mapping of parameter name to float, optional
        Values of the parameters of a model; by default the declared starts.
    broken_at : str
        An input of the plant (the actuator; by default the first), a signal that a controller
        measures (the rate, the attitude), or one that a controller commands.
    tracking : (str, str), optional
        A setpoint and the signal that responds to it; by default the first setpoint of a controller
        and its first input.
    at : mapping of name to float, optional
        The operating point of an ODE; by default that of the fitted part.
    part : int
        Whose model it is, in a fit of several problems.
    level : float
    boundary : sequence of (phase delay, bandwidth), s and rad/s, optional
        Corners of a boundary between levels of handling qualities: the least ADS-33 bandwidth, up
        to the largest phase delay.

    Returns
    -------
    Margins

    Raises
    ------
    ValueError
        If the fit has no estimate or no covariance, or the controllers do not fit the model.
    TypeError
        For a plant that is none of these, for values given with a fit, for a plant without a
        controller, and for arguments that a measured response does not take.

    Notes
    -----
    A controller is linearized about its initial state: limits that are not reached have no effect.
    The delay of a model that was fitted to a measured frequency response contains the hold of the
    control, half a sample, unless the record stated this hold; it is not counted again.

    Sources: Franklin, Powell, Workman (1998), Digital Control of Dynamic Systems, section 4.3 (the
    sampled plant) and 7.4 (margins); ADS-33E-PRF (2000), Handling Qualities Requirements for
    Military Rotorcraft, paragraph 3.3.2.1 (bandwidth and phase delay of attitudes); Tischler
    et al. (2017), Practical Methods for Aircraft and Rotorcraft Flight Control Design, section 3.3
    (disturbance rejection); Chandler and Bate (2007), Biometrika 94 (the likelihood ratio).

    Examples
    --------
    >>> from greybox.models.controller import AttitudeController
    >>> from greybox.models.tilt import Tilt
    >>> flown = AttitudeController({"K_P": 0.12}, rate=400, signals={"q": "theta_dot"})
    >>> values = {"a1": -14.6, "a2": 3.0, "a3": 8.5, "a4": 295.0, "a5": 0.16, "T_delay": 0.0042}
    >>> margins = gb.margins(Tilt(), flown, values)  # with intervals if the plant is a fit
    >>> print(f"{margins['phase margin'].value:.0f}°")
    56°
    """
    if isinstance(plant, FrequencyResponse):
        if controller or values or broken_at or tracking or at or part or boundary:
            raise TypeError(
                "a measured response is the broken loop itself: give no argument but the level."
            )
        return measured_margins(plant, level=level)
    if controller is None:
        raise TypeError("a plant has margins only in a loop: give its controller.")
    require_level(level)
    corners = sorted(number_pair(corner, "a corner of the boundary") for corner in boundary)
    loop = drawn_loops(plant, controller, values, at=at, part=part)
    fit, model = (plant, plant.model_of(part)) if isinstance(plant, Fit) else (None, plant)
    controllers = [controller] if isinstance(controller, Controller) else controller
    signal = broken_at or loop.inputs[0]
    if tracking and (isinstance(tracking, str) or len(tracking) != 2):
        raise ValueError(
            f"tracking is {tracking!r}: give two names, a setpoint and the signal that follows it."
        )
    setpoint, response = tracking or setpoint_and_response(controllers) or ("", "")
    unit = _unit(response, model, controllers)
    integrals = _INTEGRALS.get(unit)
    if boundary and integrals is None:
        raise ValueError(
            f"boundary needs an angle or its rate, and {response!r} has the unit {unit!r}: declare "
            "it in `units` of the model or the controller, or leave the boundary out."
        )

    answer = Margins(
        fit.name if fit else model.label,
        signal,
        setpoint,
        response,
        (),
        bool(loop.is_stable[0]),
        1 - float(np.mean(loop.is_stable[DRAWN])) if fit else math.nan,
        level if fit else math.nan,
        loop,
        tuple(f"The fit warns: {warning}" for warning in fit.warnings) if fit else (),
    )
    if not answer.is_stable:
        return answer

    groups: dict[str, LoopNumbers] = {
        f"broken at {signal}": lambda loops, omega: margin_numbers(
            loops.broken_at(signal, omega),
            omega,
            is_stable=loops.is_stable,
            period=loops.period,
        )
    }
    if setpoint and follows(loop, setpoint, response):
        groups[f"{setpoint} to {response}"] = partial(
            closed_loop_numbers,
            setpoint=setpoint,
            response=response,
            integrals=integrals,
            boundary=np.array(corners).T,
        )
    fitted = fit.parts[part] if fit else None
    band = np.sort(fitted.data.omega)[[0, -1]] if isinstance(fitted, FittedResponse) else None
    return _with_rows(answer, groups, band)


def _with_rows(answer: Margins, groups: Mapping[str, LoopNumbers], band: Array | None) -> Margins:
    """Return an answer with its rows, whose intervals are quantiles over the draws."""
    tail = (1 - answer.level) / 2
    loop = answer.require_loop()
    rows, undetermined, missing = [], [], {}
    for group, numbers in groups.items():
        exact = refined(loop, numbers)
        for name, (value, _) in numbers(loop, loop_frequencies(loop)).items():
            first, omega = exact[name].first
            if math.isnan(first):
                continue
            low = high = math.nan
            drawn = value[DRAWN]
            lacking = np.isnan(drawn).sum() / max(drawn.size, 1)
            if not np.allclose(value[BESIDE], value[0], rtol=1e-3):
                undetermined.append(name)
            elif lacking > tail:
                missing[name] = lacking
            elif answer.instability <= tail:
                # Draws that lack the quantity, such as a crossing, count on both sides.
                low, high = (
                    float(np.quantile(np.where(np.isnan(drawn), end, drawn), share, method=ORDER))
                    for end, share in ((-math.inf, tail), (math.inf, 1 - tail))
                )
            beyond = band is not None and bool(omega < band[0] or omega > band[1])
            unit = UNITS[name.rstrip(" 0123456789")]
            rows.append(Margin(name, unit, first, low, high, omega, beyond, group))

    notes = list(answer.notes)
    if any(row.is_extrapolated for row in rows):
        notes.insert(0, "* outside the frequencies of the fitted data: extrapolated.")
    if undetermined:
        names = listed(undetermined)
        notes.insert(0, f"No interval: the data of the fit do not determine the {names}.")
    if missing:
        share = 100 * max(missing.values())
        notes.insert(0, f"No interval: {share:.2g} % of the draws have no {listed([*missing])}.")
    return replace(answer, margins=tuple(rows), notes=tuple(notes))


def _unit(signal: str, model: Model, controllers: Sequence[Controller]) -> str:
    """Return the declared unit of a signal of the loop; empty if it has none."""
    units = {c.outside(n): u for c in controllers for n, u in c.units.items()} | dict(model.units)
    if signal not in units and signal.endswith(DOT):
        return units.get(signal.removesuffix(DOT), "") + "/s"
    return units.get(signal, "")
