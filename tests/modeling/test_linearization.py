"""Linearization about an operating point, against Jacobians by hand."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from two_tanks import AT, Tanks

import greybox as gb
from greybox.models.tilt import LinearTilt
from greybox.models.yaw import YawStates


def test_linearize_gives_the_jacobians_and_the_point():
    """By hand: k sqrt(h) is the flow, so h = (4/2)² = 4 and (3/2)² = 2.25; the slope is k / (2 sqrt(h))."""
    system = gb.modeling.linearize(Tanks(), at=AT)
    wanted = {"upper": 4.0, "lower": 2.25, **AT}
    assert_allclose([system.point[name] for name in wanted], list(wanted.values()), rtol=1e-9)
    assert_allclose(system.A, [[-0.5, 0], [0.5, -2 / 3]], rtol=1e-9)
    assert_allclose(system.B, [[1, 0], [0, -1]])
    assert_allclose(system.C, [[0, 1], [0, 3]])
    assert_allclose(system.D, [[0, 0], [0, -0.5]])
    assert_allclose(np.sort(system.poles), [-2 / 3, -0.5], rtol=1e-9)
    assert system.delays.tolist() == [0.3, 0.1]
    assert (system.states, system.inputs, system.outputs) == (
        Tanks.states,
        Tanks.inputs,
        Tanks.outputs,
    )


@pytest.mark.parametrize("read", [gb.modeling.linearize, gb.modeling.rational])
def test_unknown_parameters_are_refused(read):
    with pytest.raises(ValueError, match=r"LinearTilt has no parameter 'a6'; it has a1"):
        read(LinearTilt(), {"a6": 1.0}, **({"output": "v"} if read is gb.modeling.rational else {}))


def test_a_parameter_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match=r"a1.*nan"):
        gb.modeling.linearize(YawStates(), {"a1": math.nan})
