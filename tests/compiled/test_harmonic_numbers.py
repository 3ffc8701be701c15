"""How many harmonics the parts of a problem take before a fit: as many as matter where that is open."""

import numpy as np
import pytest
from duffing_oscillator import Spring

import greybox as gb
from greybox.compiled.compiled_problem import with_enough_harmonics
from greybox.modeling import harmonic_response

OMEGA = np.array([0.4, 0.9])


def part(name, amplitude=None):
    data = gb.FrequencyResponse(OMEGA, np.array([1.0, 1.0 - 0.5j]), "u", "x", name=name)
    return gb.Problem(Spring(), data, amplitude=amplitude)


def test_parts_that_leave_it_open_take_what_matters_at_the_start_values():
    """With more harmonics the response is the same to a part in a thousand."""
    sines = [
        None,
        gb.modeling.Sine("u", 2.0),
        gb.modeling.Sine("u", 2.0, harmonics=5),
        gb.modeling.Sine("u", 1e-3),
    ]
    problem = sum(part(f"part {k}", sine) for k, sine in enumerate(sines))
    found = with_enough_harmonics(problem)
    assert found.parts[0] is problem.parts[0]
    numbers = [each.amplitude.harmonics for each in found.parts[1:]]
    assert numbers[1] == 5
    assert numbers[0] > numbers[2]
    fewer, enough, more = (
        harmonic_response(
            Spring(), {}, OMEGA, amplitude=gb.modeling.Sine("u", 2.0, harmonics=n)
        ).response
        for n in (1, numbers[0], 9)
    )
    assert enough == pytest.approx(more, rel=1e-3)
    assert np.abs(fewer / more - 1).max() > 1e-3
    assert with_enough_harmonics(found) is found


def test_a_cost_takes_as_many_harmonics_as_a_fit():
    problem = part("open", gb.modeling.Sine("u", 2.0))
    closed = with_enough_harmonics(problem)
    assert gb.cost(problem, {}) == gb.cost(closed, {})
