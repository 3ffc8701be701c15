"""The model of a fit at its estimate: covariance of what follows from it, and the part that is meant."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.assessment.at_estimate import part_index, propagated


def test_what_depends_on_the_unknown_is_unknown():
    slope = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 3.0]])
    covariance = np.array([[4.0, 1.0, np.nan], [1.0, 9.0, np.nan], [np.nan] * 3])
    found = propagated(slope, covariance)
    assert_allclose(found[:2, :2], slope[:2, :2] @ covariance[:2, :2] @ slope[:2, :2].T)
    assert np.isnan(found[2]).all()
    assert np.isnan(found[:, 2]).all()


def test_the_part_that_is_meant_is_the_one_asked_for_or_the_record_or_the_first_of_the_model():
    class Model(gb.StateSpace):
        inputs, outputs = ("u",), ("y",)
        k = gb.Parameter(1.0)

        def output(self, x, u, p):
            return (p.k * u.u,)

    class Other(Model):
        pass

    def part(data, model=None, is_prior=False):
        name = type(model or Other()).__qualname__
        return SimpleNamespace(data=data, is_prior=is_prior, model={"class": f"elsewhere:{name}"})

    flights = [
        gb.Record(np.arange(4.0), {"u": np.arange(4.0) + k, "y": np.ones(4) * k}) for k in (0, 1, 2)
    ]
    response = gb.FrequencyResponse([1.0], [2.0])
    parts = [
        part(flights[2], is_prior=True),
        part(response),
        part(flights[0]),
        part(flights[1], Model()),
        part(response),
    ]
    fit = SimpleNamespace(parts=parts)
    assert [part_index(fit, None, k, None) for k in (0, 4, -1, -5)] == [0, 4, 4, 0]
    for wrong in (5, -6, True, 1.0):
        with pytest.raises(
            ValueError,
            match=rf"^part of a fit with 5 parts is {wrong!r}: give a whole number from -5 to 4\.$",
        ):
            part_index(fit, None, wrong, None)
    assert part_index(fit, None, None, None) == 2  # records before responses
    assert part_index(fit, None, None, flights[1]) == 3
    assert part_index(fit, Model(), None, flights[0]) == 3
    assert part_index(fit, Other(), None, flights[1]) == 2
    assert (
        part_index(SimpleNamespace(parts=parts[:2]), None, None, None) == 1
    )  # what is known before is no data
    assert part_index(SimpleNamespace(parts=parts[:2]), Model(), None, flights[0]) == 1
