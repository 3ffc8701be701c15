"""Planted redundancies are named with the combination that is determined; the table is that of the covariance."""

import numpy as np
import pytest
from random_structures import KINDS, named_rightly, planted

import greybox as gb
from greybox.assessment.storage import load, save
from greybox.problems import yaw_hover


@pytest.mark.parametrize("kind", KINDS)
def test_planted_redundancies_are_named(kind):
    truth = planted(kind, 30)
    assert not named_rightly(gb.fit(truth.problem, 4, progress=False, profiles=False), truth)


def test_nothing_is_said_of_a_structure_that_is_determined():
    for seed in range(1000, 1003):
        fit = gb.fit(planted("clean", seed).problem, 4, progress=False)
        assert not fit.identifiability.combinations
        assert not fit.identifiability.beyond
        assert not any("determined" in text for text in (*fit.warnings, *fit.notes))


def test_yaw_determines_ratios_and_not_their_members(tmp_path):
    fit = gb.fit(yaw_hover.problem(), 8, progress=False)
    told = fit.identifiability

    # By the delta method, and by the inverse of the covariance, written out.
    covariance = fit.covariance_of(fit.free)
    value = np.array([fit.estimate[name] for name in fit.free])
    np.testing.assert_allclose(told.error, np.sqrt(np.diag(covariance)) / abs(value), rtol=1e-6)
    np.testing.assert_allclose(
        told.insensitivity, 1 / np.sqrt(np.diag(np.linalg.inv(covariance))) / abs(value), rtol=1e-4
    )
    assert set(told.beyond) == {"a1_tilde", "a2", "a3_tilde"}
    ratio = next(one for one in told.combinations if one.formula == "a3_tilde/a2")
    i, j = fit.free.index("a3_tilde"), fit.free.index("a2")
    slope = np.zeros(len(value))
    slope[[i, j]] = 1 / value[j], -value[i] / value[j] ** 2
    assert ratio.value == pytest.approx(2.873, abs=0.001)
    assert ratio.standard_error == pytest.approx(np.sqrt(slope @ covariance @ slope), rel=1e-6)
    assert len(told.combinations) == 2
    assert any("a3_tilde/a2 = 2.87" in note for note in fit.notes)
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(fit.correlation, covariance / np.outer(scale, scale), atol=1e-9)

    save(fit, tmp_path / "yaw.h5")
    assert str(load(tmp_path / "yaw.h5").identifiability) == str(told)
