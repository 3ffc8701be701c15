"""Two of three records agree: the fit is theirs, and the third one is named."""

import numpy as np
import pytest
from driven_lag import Lag

import greybox as gb


def payload(factor):
    """Three records of a lag of gain 3; that of the last one is smaller or larger."""
    records = []
    for seed, own in ((1, 1.0), (2, 1.0), (3, factor)):
        random = np.random.default_rng(seed)
        time, u = np.arange(400) * 0.05, np.repeat(random.choice([-1.0, 1.0], 40), 10)
        flown = gb.Record(time, {"u": u}, hold={"u": np.inf})
        y = gb.simulate(Lag(), {"g": 3 * own, "tau": 0.4}, flown, initial={"y": 0.0})["y"]
        y = y + 0.05 * random.normal(size=400)
        records.append(gb.Record(time, {"u": u, "y": y}, hold={"u": np.inf, "y": 0.0}))
    return gb.several(Lag(), records)


@pytest.mark.parametrize("factor", [0.3, 0.5, 2.0, -1.0])
def test_two_records_of_three_agree_and_the_third_one_is_named(factor):
    """From anywhere: the first misfit that is named is that of the third record."""
    fit = gb.fit(payload(factor), 4, profiles=False, progress=False)
    assert fit.estimate["g"] == pytest.approx(3, rel=0.01)
    assert fit.agreeing == 4
    assert "'Lag 3'" in fit.misfit.causes[0].text + fit.misfit.causes[0].code
