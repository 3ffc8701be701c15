"""Bounds that hold a parameter are widened until they do not, by six decades at most."""

from dataclasses import replace

import numpy as np
import pytest

import greybox as gb
from greybox.workflows.identification.structure_fit import fit_within_far_bounds

OMEGA = np.geomspace(0.3, 30, 12)


class Pole(gb.TransferFunction):
    """A gain of any sign, and a pole on either side."""

    K = gb.Parameter(1.0, bounds=(-np.inf, np.inf))
    a = gb.Parameter(1.0, bounds=(-np.inf, np.inf), unit="1/s")

    def response(self, s, p):
        return p.K / (s + p.a)


def fitted(gain, low_high, pole=2.0, **stated):
    exact = gb.frequency_response(Pole(), {"K": gain, "a": pole}, OMEGA)
    data = replace(exact, variance=np.full(len(OMEGA), 1e-4))
    start = {"K": np.clip(gain, *low_high), "a": pole}
    bounds = {"K": low_high, "a": (-10.0, 10.0)}
    return fit_within_far_bounds(Pole(), [data], start, bounds=bounds, stated=stated)


@pytest.mark.parametrize(
    ("gain", "bounds", "pole", "widened"),
    [
        (3.0, (1e-9, 0.01), 2.0, (1e-9, 100.0)),
        (3.0, (5.0, 5000.0), -2.0, (0.05, 5000.0)),
        (-3.0, (-0.01, 0.01), -2.0, (-100.0, 0.01)),
        (-3.0, (-5000.0, -5.0), 2.0, (-5000.0, -0.05)),
        (3.0, (1.0, 10.0), 2.0, (1.0, 10.0)),
    ],
)
def test_a_gain_outside_its_bounds_is_found(gain, bounds, pole, widened):
    result = fitted(gain, bounds, pole)
    assert result.estimate == pytest.approx({"K": gain, "a": pole}, rel=1e-6)
    assert result.by_name["K"].bounds == pytest.approx(widened)


@pytest.mark.parametrize(
    ("gain", "bounds", "stated", "end"),
    [
        (1e9, (1e-4, 1.0), {}, 1e6),  # moved three times, by a hundred each
        (-3.0, (0.0, 10.0), {}, 0.0),  # where a term is absent
        (3.0, (1e-4, 1.0), {"bounds": {"K": (0.5, 2.0)}}, 2.0),  # of the user
    ],
)
def test_a_gain_stays_at_a_bound(gain, bounds, stated, end):
    quantity = fitted(gain, bounds, **stated).by_name["K"]
    assert quantity.at_bound
    assert quantity.value == pytest.approx(end, rel=1e-4, abs=1e-4)
