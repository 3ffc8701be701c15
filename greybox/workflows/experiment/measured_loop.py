"""Broken loops from measured responses, without a model; `greybox.margins` reads their margins."""

from dataclasses import replace

import numpy as np

from greybox.data.files.public import public
from greybox.data.frequency_response import FrequencyResponse


@public
def broken_loop(sensitivity: FrequencyResponse) -> FrequencyResponse:
    """Return the gain of the broken loop, L = 1/S - 1, of negative feedback.

    Errors are propagated to first order.

    Parameters
    ----------
    sensitivity : FrequencyResponse
        The measured response S from a signal that is injected into the loop, to the sum of this
        signal and the feedback at the same place: for example from ``SIDD.Targ`` to the control
        ``RATE.POut``, or from a setpoint to the error.

    Returns
    -------
    FrequencyResponse

    Raises
    ------
    ValueError
        If S differs from 1 by no more than its errors on average: the loop was open, or the test
        too weak.
    """
    S, variance = sensitivity.response, sensitivity.variance
    # The small number covers rounding: the variance of a response of exactly 1 may be zero.
    if variance is not None and np.mean(np.abs(S - 1) ** 2 / (variance + 1e-12)) < 2:
        raise ValueError(
            f"the loop was open, or too little was measured: {sensitivity.output} differs from the "
            "injected signal by no more than its errors; fly the test with the controller on, "
            "longer or with a larger amplitude."
        )
    # The errors are multiplied by the derivative of 1/S.
    return replace(sensitivity.times(-1 / S**2), response=1 / S - 1)
