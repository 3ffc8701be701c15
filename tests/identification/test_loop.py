"""The direct estimate beside the joint one."""

import numpy as np
import pytest

import greybox as gb
from greybox.identification import loop


def test_estimates_are_compared_where_both_are(monkeypatch):
    """Not beyond the direct one's band, where it would be extrapolated."""
    omega = np.arange(1.0, 6.0)
    joint = gb.FrequencyResponse(omega, [50, 2, 2, 2, 50], input="u", output="y")
    direct = gb.FrequencyResponse(omega[1:4], [2, 2.2, 2], input="u", output="y")
    monkeypatch.setattr(loop, "spectral_response", lambda *_, **__: direct)
    found = loop.direct_difference(joint, [], "u", "y")
    assert (found.median, found.largest, found.omega) == pytest.approx((0.0, 0.1, 3.0), abs=1e-12)
