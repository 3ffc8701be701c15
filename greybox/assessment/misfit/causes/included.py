"""The causes that every fit is tried for.

Each is a function that yields terms: of the `TestedRecord` for records, of the frequencies for
responses and for the Fourier integrals of manoeuvres.
"""

from collections.abc import Callable, Iterator

from greybox.assessment.misfit.causes.actuator_limits import actuator_limits
from greybox.assessment.misfit.causes.constants import loads
from greybox.assessment.misfit.causes.delays import delays
from greybox.assessment.misfit.causes.flexible_modes import flexible_modes
from greybox.assessment.misfit.causes.functions import functions
from greybox.assessment.misfit.causes.lags import lags
from greybox.assessment.misfit.causes.logged_signals import logged_signals
from greybox.assessment.misfit.causes.nonlinear_terms import feedback, nonlinear_terms, stops
from greybox.assessment.misfit.causes.parameters import (
    bounded_parameters,
    changing_parameters,
    fixed_parameters,
    own_values,
)
from greybox.assessment.misfit.causes.repeated_tests import repeated_tests
from greybox.assessment.misfit.causes.response_terms import (
    delays as delays_of_response,
    gain_steps,
    modes,
    poles,
    zeros,
)
from greybox.assessment.misfit.causes.saturations import saturations
from greybox.assessment.misfit.causes.sensors import sensors
from greybox.assessment.misfit.term import RecordTerm, ResponseTerm
from greybox.assessment.misfit.tested_record import TestedRecord
from greybox.data.files.arrays import Array

RecordCause = Callable[[TestedRecord], Iterator[RecordTerm]]
"""Yields the terms of one kind that the model of a record may lack."""

ResponseCause = Callable[[Array], Iterator[ResponseTerm]]
"""Yields the terms of one kind that the model of a response at frequencies (n,) may lack."""

CAUSES: tuple[RecordCause, ...] = (
    delays,
    lags,
    flexible_modes,
    actuator_limits,
    saturations,
    sensors,
    nonlinear_terms,
    stops,
    feedback,
    loads,
    own_values,
    changing_parameters,
    logged_signals,
    bounded_parameters,
    fixed_parameters,
    functions,
    repeated_tests,
)
RESPONSE_CAUSES: tuple[ResponseCause, ...] = (zeros, delays_of_response, poles, modes, gain_steps)
