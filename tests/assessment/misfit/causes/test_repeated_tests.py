"""What repeats with the inputs: the residuals of the period or the test before."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import greybox as gb
from greybox.assessment.misfit.causes.repeated_tests import repeated_tests
from greybox.assessment.misfit.tested_record import TestedRecord
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.compiled.disturbances import DisturbedRecord
from greybox.statistics.autoregressive_likelihood import ORDER


class Lag(gb.StateSpace):
    states, inputs, outputs = ("x",), ("u",), ("x",)
    T = gb.Parameter(0.5, bounds=(0.1, 2))

    def derivative(self, x, u, p):
        return ((u.u - x.x) / p.T,)

    def output(self, x, u, p):
        return (x.x,)


@pytest.mark.parametrize(("period", "count"), [(ORDER + 1, 4), (2 * ORDER, 2)])
def test_residuals_of_the_previous_period_are_held_against_those_of_the_next(period, count):
    """The shortest period is one sample longer than the autoregression of the errors."""
    random = np.random.default_rng(0)
    u = np.tile(random.normal(size=period), count)
    record = gb.Record(0.1 * np.arange(u.size), {"u": u, "x": random.normal(size=u.size)})
    nlp = compile_problem(gb.Problem(Lag(), record))
    (part,) = nlp.parts
    trajectory = part.trajectory(nlp.scaling.to_solver(np.array([0.5])))
    flight = DisturbedRecord(part, trajectory)
    [term] = repeated_tests(TestedRecord(flight))
    (values,) = part.data.unpadded(term.values[None])
    (residuals,) = part.data.unpadded(flight.residuals)
    assert_array_equal(values[0, :period], 0)
    assert_array_equal(values[0, period:], residuals[0, :-period])
