"""The response of a nonlinear ODE to a sine test, as a fit evaluates it.

Begin with `harmonic_response`.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.checked_array import finite_numbers
from greybox.data.frequency_response import FrequencyResponse
from greybox.files.arrays import Array, Values
from greybox.modeling.harmonic_balance import directly_found
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import Model, pick_signals
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.sine import MOST_HARMONICS, Sine, as_sine


def harmonic_response(
    model: Model,
    values: Values | None,
    omega: ArrayLike,
    *,
    amplitude: Mapping[str, ArrayLike] | Sine,
    input: str = "",
    output: str = "",
    at: Values | None = None,
    delay: str = "exact",
) -> FrequencyResponse:
    """Evaluate the response of an ODE to a sine of finite amplitude, at `omega` (n,) in rad/s.

    The response is the first harmonic of the output over that of the input: the describing function
    of a nonlinear model, the frequency response of a linear one. It is evaluated as in a fit: where
    several periodic motions exist, it is that of the search that begins at the linear response.
    Where the most harmonics do not settle it, as just above the break-away force of dry friction,
    its `about` has the change from half as many, ``truncation``.

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
    omega = finite_numbers("omega", omega)
    sine = as_sine(amplitude)
    signals = {"input": input, "output": output, "at": at, "pade": delay_order(delay)}
    response, harmonics = directly_found(model, values, omega, sine, **signals)
    finite = np.isfinite(response)
    if not finite.all():
        k = int(np.argmin(finite))
        raise ValueError(
            f"no periodic motion of {model.label} was found at omega = {omega[k]:g} rad/s in which "
            f"{sine.signal} is a sine of amplitude {sine.amplitudes(omega)[k]:g}: give another "
            "amplitude (just above the break-away force of dry friction the search may fail), or "
            "check the values and `at`."
        )

    about = {}
    if harmonics == MOST_HARMONICS:
        half = replace(sine, harmonics=harmonics // 2)
        fewer, _ = directly_found(model, values, omega, half, **signals)
        change = 100 * np.abs(fewer / response - 1).max()
        about["truncation"] = (
            f"{harmonics} harmonics, the most: with half as many the response differs by up to "
            f"{change:.2g} %"
        )

    input, output = pick_signals(model, input, output)
    return FrequencyResponse(
        omega, response, input=input, output=output, name=model.label, source="model", about=about
    )


def response_of_test(
    model: Model,
    values: Values,
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
    amplitude = sine.between(measured, np.asarray(omega, dtype=float))
    return harmonic_response(model, values, omega, amplitude=amplitude, **signals)
