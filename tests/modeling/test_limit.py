"""A parameter at its end: what stays beside it, with the values, bounds, units and words that follow from its own."""

import numpy as np
import pytest

import greybox as gb
from greybox.modeling.limit import Limit, invariant_name


class Chain(gb.TransferFunction):
    """A gain of either sign, a lag and a stiffness."""

    K = gb.Parameter(6.0, bounds=(-50, 50), unit="m/s", about="gain")
    T = gb.Parameter(2.0, bounds=(0, 100), unit="s", about="lag")
    k = gb.Parameter(5.0, bounds=(0.1, 100), unit="N")

    def response(self, s, p):
        return p.K * p.k / (p.T * s + 1)


def facts(parameter):
    return parameter.start, parameter.bounds, parameter.starts, parameter.unit, parameter.about


@pytest.mark.parametrize(
    ("member", "power", "value", "name", "expected"),
    [
        # A gain that may have either sign: a thousand times its size on both sides, starts three
        # times.
        ("K", 1, -6.0, "K_per_T", (-3.0, (-3000.0, 3000.0), (-9.0, 9.0), "m/s²", "K/T (gain)")),
        (
            "K",
            2,
            6.0,
            "K_per_T_to_2",
            (1.5, (-1500.0, 1500.0), (-4.5, 4.5), "m/s³", "K/T^2 (gain)"),
        ),
        ("K", -1, 6.0, "K_times_T", (12.0, (-12000.0, 12000.0), (-36.0, 36.0), "m", "K·T (gain)")),
        # One of a single sign keeps it.
        ("k", 3, 4.0, "k_per_T_to_3", (0.5, (0.0005, 500.0), (0.0005, 500.0), "N/s³", "k/T^3 (k)")),
        (
            "k",
            -4,
            -4.0,
            "k_times_T_to_4",
            (-64.0, (-64e3, -0.064), (-64e3, -0.064), "N·s⁴", "k·T^4 (k)"),
        ),
    ],
)
def test_what_stays_beside_a_parameter_that_goes(member, power, value, name, expected):
    model = Limit(Chain(), "T", 2.0, "infinity", ((member, power, value),))
    assert invariant_name(member, "T", power) == name
    assert set(model.parameters) == {"K", "k", name} - {member}
    start, bounds, starts, unit, about = facts(model.parameters[name])
    assert (start, bounds, starts) == (
        expected[0],
        pytest.approx(expected[1]),
        pytest.approx(expected[2]),
    )
    assert about == expected[4]
    assert unit == expected[3]
    assert model.label == "Chain, T → ∞"


def test_the_values_before_the_limit():
    kept = (("K", 1, 6.0), ("k", -2, 5.0))
    model = Limit(Chain(), "T", 2.0, "infinity", kept)
    p = {"K_per_T": 3.0, "k_times_T_to_2": 20.0}
    assert model.values_before(p, 4.0) == {"K": 12.0, "T": 4.0, "k": 1.25}
    assert model.values_before(p)["T"] == 2.0 * 2**26  # half of the digits away
    to_zero = Limit(Chain(), "T", -2.0, "zero", kept)
    assert to_zero.values_before(p)["T"] == -2.0 / 2**26
    assert to_zero.label == "Chain, T → 0"


def test_alone_it_is_zero():
    model = Limit(Chain(), "T", 2.0, "zero")
    assert model.values_before({"K": 6.0, "k": 5.0}) == {"K": 6.0, "T": 0.0, "k": 5.0}
    assert model.label == "Chain, T = 0"
    omega = np.array([0.5, 50.0])
    assert gb.frequency_response(model, {"K": 2.0, "k": 3.0}, omega).response == pytest.approx(6.0)


def test_a_name_that_is_taken_already():
    class Taken(Chain):
        K_per_T = gb.Parameter(1.0)

    with pytest.raises(ValueError, match="Taken has a parameter 'K_per_T' already: rename it"):
        Limit(Taken(), "T", 2.0, "infinity", (("K", 1, 6.0),))
