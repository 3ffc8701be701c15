"""Checks can be left out, and a user's own one joins them."""

import numpy as np
import pytest
from declared_models import Lag, measured

import greybox as gb

TRUTH = {"K": 2.0, "T": 0.3}
OMEGA = np.geomspace(0.5, 20, 20)


@pytest.fixture(scope="module")
def problem():
    return gb.Problem(Lag(), measured(Lag(), OMEGA, TRUTH, noise=0.05, seed=3))


@pytest.fixture(scope="module")
def judged(problem):
    return gb.fit(problem, 4, progress=False)


def test_without_checks_the_estimate_and_its_errors_are_equal(problem, judged, tmp_path):
    bare = gb.fit(problem, 4, checks=(), progress=False)
    assert bare.estimate == judged.estimate
    assert bare.standard_error == judged.standard_error
    assert bare.misfit is None
    assert (bare.warnings, bare.notes, bare.profiles) == ((), (), None)

    # Nothing that was not looked for is said to be good, now or from a file.
    gb.save(bare, tmp_path / "bare.h5")
    for fit in (bare, gb.load(tmp_path / "bare.h5", Lag())):
        assert fit.left_out == tuple(check.__name__ for check in gb.CHECKS)
        assert "In doubt" in str(fit)
        assert f"{len(gb.CHECKS)} checks were left out" in str(fit)
    assert "Good" in str(judged)
    assert judged.left_out == ()


def late_phase(evidence):
    """A check of a user: the phase of the last fitted point, and a remark."""
    (response,) = evidence.fit.responses
    phase = np.degrees(np.angle(response.response[-1]))
    if phase < -60:
        yield gb.Finding(f"{response.name!r} ends at a phase of {phase:.0f}°.")
    yield gb.Finding("the phase was looked at.", is_note=True)


def test_a_check_of_a_user_joins_the_included_ones(problem, judged):
    fit = gb.fit(problem, 4, checks=[*gb.CHECKS, late_phase], progress=False)
    expected = np.degrees(-np.arctan(fit.estimate["T"] * OMEGA[-1]))
    assert [text for text in fit.warnings if text not in judged.warnings] == [
        f"'made' ends at a phase of {expected:.0f}°."
    ]
    assert "the phase was looked at." in fit.notes
    assert fit.left_out == ()
    assert fit.misfit.verdict == judged.misfit.verdict


def test_one_check_by_itself_leaves_the_others_out(problem):
    fit = gb.fit(problem, 4, checks=[late_phase], progress=False)
    assert len(fit.warnings) == 1
    assert len(fit.left_out) == len(gb.CHECKS)


def test_a_failed_search_is_explained_whatever_the_checks(problem):
    fit = gb.fit(problem, 2, checks=(), solver_options={"max_iter": 0}, progress=False)
    if fit.converged:
        pytest.fail("no iteration was allowed")
    assert "came closest" in fit.warnings[0]


@pytest.mark.parametrize("checks", ["all", 3, ["misfit"], None])
def test_checks_are_functions(problem, checks):
    with pytest.raises(TypeError, match="give functions of the evidence"):
        gb.fit(problem, 1, checks=checks)
