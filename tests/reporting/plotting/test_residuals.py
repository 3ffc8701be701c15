"""Residuals of fitted records, against means and tests by hand."""

from dataclasses import replace

import numpy as np
import pytest
from declared_models import TWO_LAGS_OMEGA, Lag, measured
from drawn_lines import named
from hardening_spring import Spring, driven

import greybox as gb
from greybox.reporting.plotting.residuals import residual_figures
from greybox.statistics.correlation_statistics import whiteness


@pytest.fixture(scope="module")
def record():
    return driven(duration=6.0, noise=0.02, stiffness=4.0, damping=0.8)


@pytest.fixture(scope="module")
def spring(record):
    return gb.fit(gb.Problem(Spring(), record), starts=[{}], progress=False)


def test_residuals_have_means_over_signals_and_correlations(spring, record):
    figures = residual_figures(spring.records[0])
    labels = ["time, s", "force", "fitted position, m", "Frequency, rad/s", "Lag, samples"]
    assert [figure.label for figure in figures] == labels
    (e,) = spring.residuals[0]
    means = named(figures[1].panels[0], "", "points")
    order = np.argsort(record["force"])
    assert means.y == pytest.approx([e[rows].mean() for rows in np.array_split(order, 10)])
    assert np.all(means.low < means.y)

    test, (itself,) = whiteness([e]), figures[-1].panels
    points = named(itself, "", "points")
    assert points.y == pytest.approx(test.correlations)
    assert points.x.tolist() == [*range(1, points.y.size + 1)]
    assert itself.title.endswith(f", p = {test.p_value:.2g}")
    shade = named(itself, "99 %", "band")
    assert (set(shade.high), set(shade.low)) == ({test.bound}, {-test.bound})
    assert np.abs(test.correlations).max() < itself.limits[1] == -itself.limits[0]
    assert len(gb.plotting.residuals(spring)) == 5


def coherences(fit):
    (panel,) = residual_figures(fit.records[0])[-2].panels
    (chance,) = (series for series in panel.series if series.kind == "rule")
    return named(panel, "force", "line"), chance.y[0]


def test_noise_is_rarely_coherent_with_the_input(spring):
    line, chance = coherences(spring)
    assert np.mean(line.y > chance) < 0.1


def test_what_the_model_lacks_shows():
    record = driven(duration=40.0, noise=0.02, stiffness=4.0, damping=0.8)
    stiff = gb.fit(
        gb.Problem(Spring(), record, fixed={"stiffness": 4.6}), starts=[{}], progress=False
    )
    panels = gb.plotting.residuals(stiff)
    assert "p < 0.0001" in panels[-2].get_title()
    assert panels[-1].get_xlabel() == "position, m"
    line, chance = coherences(stiff)
    assert line.y[line.x < 4].max() > 2 * chance


class Bank(gb.StateSpace):
    """The bank angle that an aileron holds."""

    states = outputs = ("phi",)
    inputs = ("da",)
    tau = gb.Parameter(0.5, bounds=(0.1, 5), unit="s")

    def derivative(self, x, u, p):
        return ((u.da - x.phi) / p.tau,)

    def output(self, x, u, p):
        return (x.phi,)


def test_angles_are_in_degrees_on_both_axes():
    time = np.arange(0, 10, 0.05)
    random = np.random.default_rng(0)
    drive = gb.Record(time, {"da": 0.2 * np.sign(np.sin(time))}, hold={"da": np.inf})
    phi = gb.simulate(Bank(), {"tau": 0.4}, drive)["phi"] + 0.01 * random.normal(size=time.size)
    record = drive.with_signals(units={"da": "rad", "phi": "rad"}, phi=phi)
    fit = gb.fit(gb.Problem(Bank(), record), starts=1, progress=False)
    over = {figure.label: figure for figure in residual_figures(fit.records[0])}
    means = named(over["da, °"].panels[0], "", "points")
    assert means.x.min() == pytest.approx(np.degrees(-0.2))
    x = named(over["fitted φ, °"].panels[0], "", "points").x
    assert np.ptp(x) > 10


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
    assert [len(gb.plotting.residuals(fit)) for fit in fits] == [3, 2]
    with pytest.raises(ValueError, match="the fit 'lost' has no estimate: no start converged"):
        gb.plotting.residuals(replace(spring, name="lost", minima=()))
    with pytest.raises(ValueError, match="there is no record 3"):
        gb.plotting.residuals(spring, 3)
    response = gb.fit(gb.Problem(Lag(), measured(Lag(), TWO_LAGS_OMEGA)), starts=1, progress=False)
    with pytest.raises(ValueError, match=r"no record 0: the fit has 0, .* gb\.plot draws"):
        gb.plotting.residuals(response)
    with pytest.raises(TypeError, match="cannot draw 3: give a Fit"):
        gb.plotting.residuals(3)
    with pytest.raises(ValueError, match="has 5 panels"):
        gb.plotting.residuals(spring, axes=gb.plotting.residuals(spring)[:2])
