"""Which parameters differ, held against scipy's Welch test and the paper's tables."""

import numpy as np
import pytest
from declared_models import Lag, measured
from scipy.stats import ttest_ind_from_stats

import greybox as gb
from greybox.problems import pitch_5deg, pitch_hover, roll_hover


def test_each_is_welch_and_all_are_holm():
    omega = np.geomspace(0.1, 10, 12)
    fits = [
        gb.fit(gb.Problem(Lag(), measured(Lag(), omega, values, noise=noise, seed=seed)), starts=2)
        for values, noise, seed in (({"K": 2.0, "T": 0.5}, 0.02, 1), ({"K": 2.0, "T": 0.6}, 0.06, 2))
    ]
    found = gb.validation.differences(*fits, ["K", "T", "bandwidth"], labels=("a", "b"))
    quantities = [{q.name: q for q in fit.quantities} for fit in fits]
    raw = []
    for name in ("K", "T", "bandwidth"):
        a, b = (q[name] for q in quantities)
        sizes = [(q.value - q.bias, q.standard_error * np.sqrt(q.dof + 1), q.dof + 1) for q in (a, b)]
        raw.append(ttest_ind_from_stats(*sizes[0], *sizes[1], equal_var=False).pvalue)
        assert found[name].p_value == pytest.approx(raw[-1], rel=1e-9)
    by_size = sorted(raw)
    assert sorted(q.p_of_all for q in found.quantities)[0] == pytest.approx(3 * by_size[0])
    assert found["T"].differs
    assert not found["K"].differs
    assert found.verdict.startswith("T and bandwidth differ beyond the errors; no difference of K")
    with pytest.raises(ValueError, match="the fits share data"):
        gb.validation.differences(fits[0], fits[0])


def test_the_paper_finds_that_a1_and_a3_change_with_the_angle_of_flight():
    """Section 4.2: "The parameters a1 and a3 of (4.23) change significantly when the tilt angle is not near zero"."""
    roll, pitch, moving = (gb.fit(m.problem(), starts=4) for m in (roll_hover, pitch_hover, pitch_5deg))
    angle = gb.validation.differences(pitch, moving)
    assert {q.name for q in angle.quantities if q.differs} >= {"a1", "a3"}
    axis = gb.validation.differences(roll, pitch)
    assert axis["a1"].differs
    assert not axis["a4"].differs
