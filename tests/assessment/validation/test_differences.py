"""Which parameters differ, held against scipy's Welch test and the paper's tables."""

from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import Lag, measured
from scipy.stats import norm, t, ttest_ind_from_stats

import greybox as gb
from greybox.assessment.validation.differences import Difference, Differences, holm, welch
from greybox.problems import pitch_5deg, pitch_hover, roll_hover


def test_each_is_welch_and_all_areholm():
    omega = np.geomspace(0.1, 10, 12)
    fits = [
        gb.fit(gb.Problem(Lag(), measured(Lag(), omega, values, noise=noise, seed=seed)), starts=2)
        for values, noise, seed in (
            ({"K": 2.0, "T": 0.5}, 0.02, 1),
            ({"K": 2.0, "T": 0.6}, 0.06, 2),
        )
    ]
    found = gb.validation.differences(*fits, ["K", "T", "bandwidth"])
    quantities = [{q.name: q for q in fit.quantities} for fit in fits]
    raw = []
    for name in ("K", "T", "bandwidth"):
        a, b = (q[name] for q in quantities)
        sizes = [
            (q.value - q.bias, q.standard_error * np.sqrt(q.dof + 1), q.dof + 1) for q in (a, b)
        ]
        raw.append(ttest_ind_from_stats(*sizes[0], *sizes[1], equal_var=False).pvalue)
        assert found[name].p_value == pytest.approx(raw[-1], rel=1e-9)
    by_size = sorted(raw)
    assert sorted(q.p_of_all for q in found.quantities)[0] == pytest.approx(3 * by_size[0])
    assert found["T"].differs
    assert not found["K"].differs
    assert found.verdict.startswith("T and bandwidth differ beyond the errors; no difference of K")
    with pytest.raises(ValueError, match="the fits share data"):
        gb.validation.differences(fits[0], fits[0])
    renamed = gb.Problem(Lag(), fits[1].responses[0].data, rename={"K": "K_b", "T": "T_b"})
    other = gb.fit(renamed, starts=1, progress=False, profiles=False)
    with pytest.raises(ValueError, match="Lag 1 and Lag 2 have no free parameter in common"):
        gb.validation.differences(fits[0], other)
    with pytest.raises(ValueError, match="Lag 2 has no parameter 'K'"):
        gb.validation.differences(fits[0], other, ["K"])


def test_the_paper_finds_that_a1_and_a3_change_with_the_angle_of_flight():
    """Section 4.2: "The parameters a1 and a3 of (4.23) change significantly when the tilt angle is not near zero"."""
    roll, pitch, moving = (
        gb.fit(m.problem(), starts=4) for m in (roll_hover, pitch_hover, pitch_5deg)
    )
    angle = gb.validation.differences(pitch, moving)
    assert {q.name for q in angle.quantities if q.differs} >= {"a1", "a3"}
    axis = gb.validation.differences(roll, pitch)
    assert axis["a1"].differs
    assert not axis["a4"].differs


def test_holms_p_values_grow_with_the_raw_ones_and_end_at_one():
    assert holm([0.04, np.nan, 0.01, 0.03, 0.5]) == pytest.approx(
        [0.09, np.nan, 0.04, 0.09, 0.5], nan_ok=True
    )
    assert holm([0.4, 0.6]) == pytest.approx([0.8, 0.8])
    assert holm([0.7, 0.6]) == [1.0, 1.0]
    assert holm([0.9]) == [0.9]


def test_errors_that_are_known_exactly_make_the_test_normal():
    def p_value(*values_errors_dof):
        quantities = [
            SimpleNamespace(value=v, bias=0.0, standard_error=e, dof=dof)
            for v, e, dof in values_errors_dof
        ]
        return welch(*quantities)

    known = p_value((1.0, 0.3, np.inf), (0.0, 0.4, np.inf))
    assert known == pytest.approx(2 * norm.sf(2.0), rel=1e-6)
    assert np.isnan(p_value((1.0, np.nan, 9.0), (0.0, 0.4, 9.0)))
    assert np.isnan(p_value((1.0, 0.0, 9.0), (0.0, 0.0, 9.0)))
    assert np.isnan(p_value((1.0, np.inf, 9.0), (0.0, 0.4, 9.0)))
    assert p_value((1.0, 0.0, 3.0), (0.0, 0.5, 9.0)) == pytest.approx(2 * t.sf(2.0, 9))


def test_it_prints_a_table_and_a_sentence():
    rows = (
        Difference("K", "1/s", (2.0, 3.0), (0.03, 0.04), 0.0001, 0.0002),
        Difference("T", "s", (0.5, 0.52), (0.01, 0.02), 0.3, 0.3),
        Difference("c", "", (0.5, 0.52), (0.01, np.nan), np.nan, np.nan),
    )
    found = Differences(("hover", "climb"), rows)
    lines = [line.split("  ") for line in str(found).splitlines()]
    header, k, lag, c = ([cell.strip() for cell in lines[i] if cell.strip()] for i in (2, 4, 5, 6))
    assert header == ["parameter", "hover", "climb", "difference", "unit", "p"]
    assert k == ["K", "2.000 ± 0.030", "3.000 ± 0.040", "1.000 ± 0.050", "1/s", "0.0002", "differs"]
    assert lag == ["T", "0.500 ± 0.010", "0.520 ± 0.020", "0.020 ± 0.022", "s", "0.3"]
    assert (c[0], c[-1]) == ("c", "-")
    assert str(found).startswith("K differs beyond the errors; no difference of T")
    assert repr(found).startswith("<Differences K differs beyond the errors; no difference of T")
    assert (found["K"].differs, found["T"].differs) == (True, False)
    with pytest.raises(KeyError, match="there is no 'tau'; there are K, T, c"):
        found["tau"]


def test_the_fit_that_lacks_a_parameter_is_named():
    omega = np.geomspace(0.1, 10, 6)
    one, other = (measured(Lag(), omega, {"K": 2.0, "T": 0.5}, noise=0.02, seed=k) for k in (1, 2))
    fits = [
        gb.fit(gb.Problem(Lag(), data, rename=rename), starts=1, progress=False, profiles=False)
        for data, rename in ((one, {"K": "K_a"}), (other, {"K": "K_b"}))
    ]
    for name, label in (("K_a", "Lag 2"), ("K_b", "Lag 1")):
        with pytest.raises(ValueError, match=f"{label} has no parameter '{name}'"):
            gb.validation.differences(*fits, [name])
    assert [q.name for q in gb.validation.differences(*fits).quantities] == ["T"]
    assert gb.validation.differences(*fits).labels == ("Lag 1", "Lag 2")
