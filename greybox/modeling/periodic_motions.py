"""The response of a nonlinear ODE to a sine test; it warns where several motions are possible.

Begin with `harmonic_response`. A nonlinear ODE may have several periodic motions under one sine. A
test that raises the amplitude slowly shows one of them. A test that lowers it slowly may show
another, as a hardening spring does between its two jumps. Newton's method looks for both, from the
linear response and from the response at ten times the amplitude.
"""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from greybox.data.frequency_response import FrequencyResponse
from greybox.files.arrays import Array, ComplexArray
from greybox.modeling.harmonic_balance import HarmonicBalance, compiled_balance, directly_found
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import Model, pick_signals
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.sine import MOST_HARMONICS, Sine, as_sine

# Relative difference of two responses above which they belong to different motions: three times the
# change that a larger number of harmonics may cause.
DISTINCT = 1e-3
# Relative change of a response by the second half of its harmonics that is worth a warning. Dry
# friction with stops was off by a tenth of its change to six times its change.
INEXACT = 0.003


def harmonic_response(
    model: Model,
    values: Mapping[str, float] | None,
    omega: ArrayLike,
    *,
    amplitude: Mapping[str, ArrayLike] | Sine,
    input: str = "",
    output: str = "",
    at: Mapping[str, float] | None = None,
    delay: str = "exact",
) -> FrequencyResponse:
    """Evaluate the response of an ODE to a sine of finite amplitude, at `omega` (n,) in rad/s.

    The response is the first harmonic of the output over that of the input: the describing function
    of a nonlinear model, the frequency response of a linear one. If several periodic motions exist,
    the response is that of a test which raises the amplitude slowly, and a UserWarning reports the
    others. With jumps such as those of dry friction, another one reports a response that half as
    many harmonics would change by more than 0.3 %.

    Parameters
    ----------
    amplitude : ``{signal: amplitude}`` or Sine
        Which signal is the sine: the input, or a state or an output that a loop holds to it. Its
        mean, and all other inputs, are what they are at the operating point `at`.
    values, input, output, at, delay
        As for `frequency_response`.

    Raises
    ------
    ValueError
        For an unknown name or a transfer function, or if no periodic motion is found.
    """
    omega = np.atleast_1d(np.asarray(omega, dtype=float))
    sine = as_sine(amplitude)
    signals = {"input": input, "output": output, "at": at, "delay": delay}
    response, messages = periodic_motions(model, values, omega, sine, **signals)
    for message in messages:
        warnings.warn(message, UserWarning, stacklevel=2)
    return _checked(model, sine, omega, response, **signals)


def response_of_test(
    model: Model,
    values: Mapping[str, float],
    omega: ArrayLike,
    sine: Sine | None,
    measured: Array,
    **signals: Any,
) -> FrequencyResponse:
    """Evaluate the response to a sine test, interpolated between the `measured` frequencies.

    Without a sine it is the response of the linearization.
    """
    if sine is None:
        return frequency_response(model, values, omega, **signals)
    omega = np.atleast_1d(np.asarray(omega, dtype=float))
    sine = sine.between(measured, omega)
    response, _ = directly_found(model, values, omega, sine, **_with_order(**signals))
    return _checked(model, sine, omega, response, **signals)


def _with_order(delay: str = "exact", **signals: Any) -> dict[str, Any]:
    """Return the options with the order of the Padé approximation in place of its name."""
    return {**signals, "pade": delay_order(delay)}


def _checked(
    model: Model,
    sine: Sine,
    omega: Array,
    response: ComplexArray,
    *,
    input: str = "",
    output: str = "",
    **_: Any,
) -> FrequencyResponse:
    finite = np.isfinite(response)
    if not finite.all():
        k = int(np.argmin(finite))
        place = _place(sine, omega[k], sine.amplitudes(omega)[k])
        raise ValueError(
            f"no periodic motion of {model.label} was found {place}: give another amplitude (just "
            "above the break-away force of dry friction the search may fail), or check the values "
            "and `at`."
        )

    input, output = pick_signals(model, input, output)
    return FrequencyResponse(
        omega, response, input=input, output=output, name=model.label, source="model"
    )


def periodic_motions(
    model: Model, values: Mapping[str, float] | None, omega: Array, sine: Sine, **signals: Any
) -> tuple[ComplexArray, list[str]]:
    """Return the response (n,) near the linear one, and messages on other motions.

    The response is NaN where no motion is found.
    """
    options = _with_order(**signals)
    direct, number = directly_found(model, values, omega, sine, **options)
    if not np.isfinite(direct).all():
        # The search for harmonics went to its limit in vain.
        number = min(number, 7)
    elif sine.harmonics is None:
        # One harmonic has the folds of a spring at other amplitudes.
        number = max(number, 3)

    balance = compiled_balance(model, omega, replace(sine, harmonics=number), **options)
    if balance.is_linear:
        return direct, []

    messages = []
    # Harmonics of smooth formulas fall fast, and a number that was found to suffice needs no check.
    if balance.switches and number == (sine.harmonics or MOST_HARMONICS) > 1:
        fewer = replace(sine, harmonics=number // 2)
        few, _ = directly_found(model, values, omega, fewer, **options)
        change = np.nanmax(np.abs(few / direct - 1), initial=0.0)
        if change > INEXACT:
            messages.append(
                f"the response of {model.label} changes by up to {100 * change:.2g} % between "
                f"{number // 2} and {number} harmonics: its error may be several times that."
            )

    vector = ca.DM(list(model.values(values).values()))
    settings = np.asarray(ca.DM(balance.settings(vector, omega)))
    response = direct.copy()
    for k, column in enumerate(settings.T):
        # As if the amplitude were raised, from where a model is nearly linear, or lowered: the
        # amplitudes at which a resonance jumps up and falls back differ by less than ten.
        raised, lowered = (_continued(balance, column, factor) for factor in (1e-3, 10.0))
        motions = [m for m in (raised, direct[k], lowered) if np.isfinite(m)]
        if motions and not np.isclose(motions[0], direct[k], DISTINCT, 0):
            response[k] = motions[0]
        distinct = [m for m in motions if not np.isclose(m, response[k], DISTINCT, 0)]
        if distinct:
            messages.append(
                f"{model.label} has several periodic motions {_place(sine, *column[-2:])}: the "
                f"response {abs(response[k]):.4g} of a test that raises the amplitude slowly is "
                f"used, and other tests may show {abs(distinct[-1]):.4g} at "
                f"{np.angle(distinct[-1], deg=True):.1f}°."
            )

    return response, messages


def _continued(balance: HarmonicBalance, settings: Array, factor: float) -> complex:
    """Return the response whose search begins at that of `factor` times the amplitude, or NaN."""
    # Harmonics are per amplitude: multiplied, they are those of the same motion.
    x = factor * balance.guess(np.append(settings[:-1], factor * settings[-1]))
    response, converged = balance.finish(balance.careful(x0=x, p=settings)["x"], settings)
    return complex(*map(float, ca.vertsplit(response))) if converged else complex(np.nan)


def _place(sine: Sine, omega: float, amplitude: float) -> str:
    return f"at omega = {omega:g} rad/s in which {sine.signal} is a sine of amplitude {amplitude:g}"
