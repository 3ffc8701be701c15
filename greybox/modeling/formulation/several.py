"""One model for several records or responses, with shared parameters and parameters of each."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from greybox.data.files.argument_checks import as_names
from greybox.data.files.arrays import Interval
from greybox.data.files.public import public
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.several_responses import problems_of_responses, responses_in
from greybox.modeling.formulation.sum import Sum
from greybox.modeling.model import Model, require_known

Responses = (
    Sequence[FrequencyResponse]
    | Sequence[Sequence[FrequencyResponse | None]]
    | np.ndarray[Any, Any]
    | Mapping[str, FrequencyResponse]
    | Mapping[tuple[str, str], FrequencyResponse]
)
"""Responses in a list, in a matrix, or by pair."""


@public
def several(
    model: Model,
    data: Sequence[Record | TransientSpectrum] | Responses,
    own: Sequence[str] = (),
    *,
    weight: float | Mapping[str, float] = 1.0,
    band: Mapping[str, Interval] | None = None,
    **options: Any,
) -> Sum[Problem]:
    """Return the sum of a problem for every record or response of one model.

    All parameters but `own` are shared.

    Every record is weighted by its own estimated noise variances: a record that the model fits
    badly has little weight. To give records of one sensor equal weight, give its standard
    deviation, ``criterion=OutputError(noise={"y": 0.1})``; for a single output any value will do,
    since the standard errors use the residual variance. Or join the records to one record with gaps
    in its time, and ``gaps="cut"``.

    Parameters
    ----------
    model : Model
    data : sequence of Record; or sequence, matrix or mapping by pair of FrequencyResponse
        Records may have different lengths and rates; every record has its own initial states.
        Responses by pair are ``{"p/lat": response}`` or ``{("p", "lat"): response}`` (output,
        input); in a matrix, a pair that was not measured is None. Every response makes a part that
        is named by its pair. Read them with `gb.data.read_responses`.
    own : sequence of str
        Parameters of each record or response, named ``<name>_1``, ``<name>_2`` ...; the biases of
        the criterion are always such, unless `rename` gives them one name.
    weight : float, or mapping of pair to float
        Weight of every part in the sum; by pair, ``{"p/lat": 2}``, of single responses.
    band : mapping of pair to (float, float), rad/s
        The frequencies to fit of single responses, ``{"p/lat": (0.5, 10)}``.
    options
        Options of every `Problem`: criterion, fixed, tied, constraints ...

    Raises
    ------
    ValueError
        For a name that is not a parameter, a pair without a response, or fewer than two records.
    TypeError
        For a mapping by anything but pairs, and for the `band` of records.

    Examples
    --------
    >>> from greybox.models.specific_force import BodyDrag
    >>> from greybox.problems import nanobench_drag
    >>> criterion = gb.OutputError(biases=("a_x", "a_y"))  # offsets of each flight
    >>> both = gb.several(BodyDrag(), nanobench_drag.data(), criterion=criterion)
    >>> len(both.parts)
    2
    """
    responses = responses_in(data)
    if responses:
        problems = problems_of_responses(
            model, responses, weight=weight, band=band or {}, **options
        )
    elif band is None:
        problems = _problems_of_records(model, data, {"weight": weight, **options})
    else:
        raise TypeError("band is for several responses: cut one by .between(low, high).")

    return Sum(tuple(_with_own_parameters(problems, as_names(own))))


def _problems_of_records(model: Model, records: Any, options: dict[str, Any]) -> list[Problem]:
    """Return a problem for every record, so that its noise and its initial states are its own."""
    if not isinstance(records, Sequence) or len(records) < 2:
        raise ValueError(
            "several() takes a list of at least two records: for one, use Problem(model, record)."
        )
    return [Problem(model, record, **options) for record in records]


def _with_own_parameters(problems: Sequence[Problem], own: Sequence[str]) -> list[Problem]:
    """Return the problems with these parameters renamed by the number of the problem."""
    if not own:
        return list(problems)

    renamed = []
    for number, problem in enumerate(problems, start=1):
        require_known(own, problem.declared, "parameter", problem.model.label)
        numbered = {name: f"{name}_{number}" for name in own}
        renamed.append(problem.with_(rename={**problem.rename, **numbered}))
    return renamed
