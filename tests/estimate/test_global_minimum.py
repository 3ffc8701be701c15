"""What is said of other minima."""

from types import SimpleNamespace

import pytest

from greybox.estimate.diagnostics.global_minimum import rival_minima


def said(is_likelihood, *costs):
    nlp = SimpleNamespace(parts=[SimpleNamespace(is_likelihood=is_likelihood)])
    minima = [SimpleNamespace(cost=cost) for cost in costs]
    return [*rival_minima(nlp, SimpleNamespace(minima=minima))]


@pytest.mark.parametrize(
    ("is_likelihood", "costs", "rivals"),
    [
        (True, (-10.0, -9.0), 1),  # e times less likely
        (True, (-10.0, 0.0), 0),  # e¹⁰ = 22026 times
        (False, (1.0, 1.005), 1),
        (False, (1.0, 2.0), 0),
        (False, (1.0,), 0),
    ],
)
def test_minima_that_the_data_hardly_tell_apart_are_named(is_likelihood, costs, rivals):
    assert len(said(is_likelihood, *costs)) == rivals
