"""What a fixed-step integrator does to an estimate is seen, also where it feigns knowledge."""

import re

import pytest
from hard_models import Swing, stiff_lag, swung
from numpy.testing import assert_allclose

import greybox as gb

COARSE = gb.MultipleShooting(integrator=gb.RungeKutta(1))


def test_a_rate_at_the_limit_of_stability_is_not_believed():
    """The data hold nothing of k; Runge-Kutta steps of 2.78 / k would determine it to 0.2 %, whatever their length."""
    fit = gb.fit(stiff_lag(), starts=1)
    believed = fit.standard_error["k"] < 0.05 * fit.estimate["k"]
    assert not believed or any("integration is too coarse" in warning for warning in fit.warnings)


def test_runs_and_minima_tell_the_same_when_substeps_were_refined():
    """What the fit says of its runs is what a fit with as many substeps from the start says."""
    problem = gb.Problem(Swing(), swung(), gb.OutputError(inputs="held"))
    starts = [{"k1": 90, "k2": 20}, {"k1": 20, "k2": 90}, {"k1": 95, "k2": 25, "c": 1.0}]
    fit = gb.fit(problem, starts=starts, progress=False)
    count = int(fit.records[0].method.split("RK4, ")[1].split()[0])
    method = gb.MultipleShooting(integrator=gb.RungeKutta(count))
    fixed, coarse = (gb.fit(problem, starts=starts, progress=False, method=m) for m in (method, COARSE))
    assert abs(fixed.cost - coarse.cost) > 0.05  # the refinement did change the cost
    assert [fit.runs[k].cost for m in fit.minima for k in m.runs[:1]] == [m.cost for m in fit.minima]
    assert fit.runs[fit.minima[0].runs[0]].cost == fit.cost
    assert len(fit.minima[0].runs) == 3
    for run, other in zip(fit.runs, fixed.runs, strict=True):
        assert run.cost == pytest.approx(other.cost, abs=1e-5)
        assert_allclose(run.estimate, other.estimate, rtol=1e-5)


def coarse_warnings(record, integrator=None):
    method = gb.MultipleShooting(integrator=integrator or gb.RungeKutta())
    problem = gb.Problem(Swing(), record, gb.OutputError(inputs="held"))
    fit = gb.fit(problem, starts=1, progress=False, method=method)
    return [w for w in fit.warnings if "integration is too coarse" in w]


PROPOSED = re.compile(r"RungeKutta\(substeps=(\d+)")


@pytest.mark.parametrize("few", [2, 5])
def test_the_numbers_of_substeps_that_are_proposed_lead_to_enough(few):
    record, tried = swung(), [few]
    while said := coarse_warnings(record, gb.RungeKutta(tried[-1])):
        tried.append(int(PROPOSED.search(said[0])[1]))
    assert 2 <= len(tried) <= 3
    assert tried[-1] <= 64


def test_where_the_cap_is_reached_the_method_for_stiff_models_comes_first():
    """Noise of a tenth of a billionth: what is proposed next is enough."""
    record = swung(step=0.8, noise=1e-10, n=60)
    (said,) = coarse_warnings(record)
    assert said.index("Rosenbrock()") < said.index("RungeKutta(substeps=")
    assert not coarse_warnings(record, gb.RungeKutta(int(PROPOSED.search(said)[1])))
