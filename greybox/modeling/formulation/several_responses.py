"""The problems of one model for several responses, in any form in which they are given."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.data.files.arrays import Interval
from greybox.data.frequency_response import FrequencyResponse
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.unsupported_data import described
from greybox.modeling.model import Model, require_known


def responses_in(data: Any) -> list[FrequencyResponse]:
    """Return the responses of a list, a matrix or a mapping by pair; none for other data.

    Raises
    ------
    TypeError
        For a mapping with responses whose keys are not pairs of output and input.
    """
    if isinstance(data, Mapping):
        return _responses_by_pair(data)
    if isinstance(data, np.ndarray):
        data = data.ravel().tolist()
    if not isinstance(data, list | tuple):
        return []

    responses = []
    for row in data:
        # A pair that was not measured is None in a matrix.
        items = row if isinstance(row, list | tuple) else (row,)
        responses += [item for item in items if item is not None]
    return responses if all(isinstance(r, FrequencyResponse) for r in responses) else []


def problems_of_responses(
    model: Model,
    responses: list[FrequencyResponse],
    *,
    weight: float | Mapping[str, float],
    band: Mapping[str, Interval],
    **options: Any,
) -> list[Problem]:
    """Return a problem for every response, named by its pair.

    Raises
    ------
    ValueError
        If `weight` or `band` names a pair that is not among the responses.
    """
    pairs = [response.pair for response in responses]
    weights = weight if isinstance(weight, Mapping) else dict.fromkeys(pairs, weight)
    for by_pair in (weights, band):
        require_known(by_pair, pairs, "pair", "the list of responses")

    problems = []
    for pair, response in zip(pairs, responses, strict=True):
        within = response.between(*band[pair]) if pair in band else response
        stated = {"name": pair, **options, "weight": weights.get(pair, 1.0)}
        problems.append(Problem(model, within, **stated))
    return problems


def _responses_by_pair(data: Mapping[Any, Any]) -> list[FrequencyResponse]:
    """Return the responses of a mapping, with the signals that its keys name."""
    if not any(isinstance(response, FrequencyResponse) for response in data.values()):
        return []

    responses = []
    for pair, response in data.items():
        names = pair if isinstance(pair, tuple) else str(pair).split("/", 1)
        output, input = names if len(names) == 2 else ("", "")
        if not (output and input and isinstance(response, FrequencyResponse)):
            raise TypeError(f"data is {described(data)}.")
        responses.append(replace(response, output=output, input=input))
    return responses
