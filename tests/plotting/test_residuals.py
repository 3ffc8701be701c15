"""Residuals of fitted records, against histograms and tests by hand."""

from dataclasses import replace

import numpy as np
import pytest
from declared_models import TWO_LAGS_OMEGA, Lag, measured
from drawn_lines import named
from hardening_spring import Spring, driven
from scipy.integrate import trapezoid

import greybox as gb
from greybox.plotting.residuals import residual_figures
from greybox.statistics.metrics import cross_correlation, whiteness


@pytest.fixture(scope="module")
def record():
    return driven(duration=6.0, noise=0.02, stiffness=4.0, damping=0.8)


@pytest.fixture(scope="module")
def spring(record):
    return gb.fit(gb.Problem(Spring(), record), starts=[{}], progress=False)


def test_residuals_have_a_histogram_and_their_correlations(spring, record):
    distribution, correlations = residual_figures(spring.records[0])
    (e,) = spring.residuals[0]
    histogram, normal = distribution.panels[0].series
    x = normal.x[100]
    density = np.exp(-0.5 * ((x - e.mean()) / e.std()) ** 2) / (e.std() * np.sqrt(2 * np.pi))
    assert normal.y[100] == pytest.approx(density)
    assert trapezoid(histogram.high, histogram.x) == pytest.approx(1)
    assert distribution.label == "Residual of position, m"

    itself, force = correlations.panels
    assert (itself.label, force.label) == ("Autocorrelation", "Correlation with force")
    for panel, test in (
        (itself, whiteness([e])),
        (force, cross_correlation([e], [record["force"]])),
    ):
        points = named(panel, "", "points")
        assert points.y == pytest.approx(test.correlations)
        assert points.x.tolist() == [*range(1, points.y.size + 1)]
        np.testing.assert_array_equal(points.low, np.minimum(points.y, 0))
        assert panel.title.endswith(f", p = {test.p_value:.2g}")
        shade = named(panel, "99 %", "band")
        assert (set(shade.high), set(shade.low)) == ({test.bound}, {-test.bound})
        most = max(np.abs(test.correlations).max(), test.bound)
        assert most < panel.limits[1] == -panel.limits[0] < 1.5 * most
    assert (correlations.label, correlations.is_whole) == ("Lag, samples", True)
    assert "with themselves p" in correlations.caption
    assert len(gb.plotting.residuals(spring)) == 3


def test_what_the_model_lacks_shows(record):
    stiff = gb.fit(
        gb.Problem(Spring(), record, fixed={"stiffness": 4.6}), starts=[{}], progress=False
    )
    assert "p < 0.0001" in gb.plotting.residuals(stiff)[1].get_title()


def test_constant_inputs_and_rows_without_a_time_have_no_correlations(spring, record):
    class Line(gb.StateSpace):
        inputs, outputs = ("x",), ("y",)
        a = gb.Parameter(1.0)

        def output(self, x, u, p):
            return (p.a * u.x,)

    time = np.arange(30.0)
    still = gb.Record(time, {"x": np.ones(30), "y": 2 + 0.1 * np.sin(time**2)})
    rows = gb.Record(time, {"x": time, "y": time + 0.1 * np.sin(time**2)}, has_time=False)
    fits = [gb.fit(gb.Problem(Line(), each), starts=[{}], progress=False) for each in (still, rows)]
    assert [len(gb.plotting.residuals(fit)) for fit in fits] == [2, 1]
    with pytest.raises(ValueError, match="the fit 'lost' has no estimate: no start converged"):
        gb.plotting.residuals(replace(spring, name="lost", minima=()))
    with pytest.raises(ValueError, match="there is no record 3"):
        gb.plotting.residuals(spring, 3)
    response = gb.fit(gb.Problem(Lag(), measured(Lag(), TWO_LAGS_OMEGA)), starts=1, progress=False)
    with pytest.raises(ValueError, match=r"no record 0: the fit has 0, .* gb\.plot draws"):
        gb.plotting.residuals(response)
    with pytest.raises(TypeError, match="cannot draw 3: give a Fit"):
        gb.plotting.residuals(3)
    with pytest.raises(ValueError, match="has 3 panels"):
        gb.plotting.residuals(spring, axes=gb.plotting.residuals(spring)[:2])
