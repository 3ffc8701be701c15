"""Which frequencies tell of a parameter, against least squares by hand and against leaving points out."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.estimate.sensitivity import sensitivity
from greybox.models.polynomial import Polynomial

OMEGA = np.geomspace(0.1, 100, 25)


class LagAndDelay(gb.TransferFunction):
    """A gain, a lag and a delay."""

    K = gb.Parameter(2.0, bounds=(0.1, 10))
    T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s")
    d = gb.Parameter(0.01, bounds=(0, 0.5), unit="s")

    def response(self, s, p):
        return p.K * gb.exp(-s * p.d) / (p.T * s + 1)


def lag(omega):
    return 2 * np.exp(-0.01j * omega) / (1 + 0.5j * omega)


@pytest.fixture(scope="module")
def answer():
    size = 0.05 * np.abs(lag(OMEGA))
    data = gb.FrequencyResponse(OMEGA, lag(OMEGA), "u", "y", variance=size**2)
    return gb.fit(
        gb.Problem(LagAndDelay(), data, gb.MaximumLikelihood()), starts=[{}], progress=False
    )


def test_shares_are_those_of_the_jacobian(answer):
    s = 1j * OMEGA
    jacobian = np.column_stack([np.full(25, 0.5), -s / (1 + 0.5 * s), -s])  # of log P
    rows = np.vstack([jacobian.real, jacobian.imag])
    along = rows @ np.linalg.inv(rows.T @ rows)
    for found, each in ((answer.sensitivity().shares, along), (answer.sensitivity().alone, rows)):
        squares = (each**2).reshape(2, 25, 3).sum(axis=0)
        assert_allclose(found[:, 0], (squares / squares.sum(axis=0)).T, rtol=1e-5, atol=1e-12)


def test_leaving_out_what_tells_of_a_parameter_costs_its_error(answer):
    found = answer.sensitivity()
    assert found.band("d")[0] > 10  # a delay shows at high frequencies
    data = answer.responses[0].data

    def error(name, kept):
        few = gb.FrequencyResponse(
            data.omega[kept], data.response[kept], "u", "y", variance=data.variance[kept]
        )
        problem = gb.Problem(LagAndDelay(), few, gb.MaximumLikelihood())
        return gb.fit(problem, starts=[{}], progress=False).standard_error[name]

    for k, name in enumerate(found.names):
        order = np.argsort(found.shares[k, 0])
        assert error(name, order[:-8]) > 1.2 * error(
            name, order[8:]
        )  # without the most, without the least telling
    assert str(found).splitlines()[4].startswith("d ")


def test_it_is_drawn_a_panel_for_each_parameter(answer):
    axes = gb.plotting.sensitivity(answer)
    assert [ax.get_ylabel() for ax in axes] == ["K, %", "T, %", "d, %"]
    gray, color = axes[2].get_lines()
    assert_allclose(color.get_ydata(), 100 * answer.sensitivity().shares[2, 0])
    assert_allclose(gray.get_ydata(), 100 * answer.sensitivity().alone[2, 0])


@pytest.mark.parametrize("lost", [4, 400])
def test_every_part_of_a_record_in_which_the_input_moves_tells_something(lost):
    """Also where the record goes on, after a sample that was lost, in the second of its parts."""
    time = 0.02 * np.arange(1000)
    u = np.cos(time**2 / 4)
    y = gb.simulate(Polynomial(1, 0), {"b0": 2.0, "a0": 1.5}, gb.Record(time, {"u": u}))["y"]
    y = y + 0.02 * np.random.default_rng(0).normal(size=1000)
    record = gb.Record(time, {"u": np.where(np.arange(1000) == lost, np.nan, u), "y": y})
    found = gb.fit(
        gb.Problem(Polynomial(1, 0), record), starts=[{"b0": 2.0, "a0": 1.5}], progress=False
    ).sensitivity()
    assert_allclose(found.shares.sum(axis=(1, 2)), 1.0)
    assert_allclose(found.alone.sum(axis=(1, 2)), 1.0)
    assert np.all(found.alone > 0)  # the input moves all the time


@pytest.mark.parametrize(("unit", "wanted"), [("rad/s", (10.0, 40.0)), ("s", (0.5, 3.0))])
def test_the_band_is_the_narrowest_that_holds_the_share(unit, wanted):
    """In the logarithm of frequencies, in time as it is; of all outputs together; points are put in order."""
    at = np.array([3.0, 0.5, 10.0, 2.0, 20.0, 40.0])
    shares = np.array([[0.1, 0.2, 0.1, 0.2, 0.2, 0.2], [0, 0, 0, 0, 0, 0]])
    two = np.hstack([0.3 * shares, 0.7 * shares])
    found = sensitivity(["K", "T"], ["y", "z"], unit, at, two, 2 * two)
    assert found.at.tolist() == [0.5, 2, 3, 10, 20, 40]
    assert_allclose(found.shares[0].sum(axis=0), [0.2, 0.2, 0.1, 0.1, 0.2, 0.2])
    assert_allclose(found.alone, 2 * found.shares)
    assert found.band("K", 0.5) == wanted
    assert found.band("K", 1.0) == (0.5, 40.0)
    assert np.isnan(found.band("T")).all()
    assert "not determined" in str(found)
    assert "y 30 %, z 70 %" in str(found)
