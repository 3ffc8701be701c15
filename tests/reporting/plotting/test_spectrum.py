"""The figure of a manoeuvre's transforms."""

from dataclasses import replace

import numpy as np
import pytest
from benchmark_module import benchmark

import greybox as gb

study = benchmark("transient_coverage")


@pytest.fixture(scope="module")
def fit():
    noisy = study.measured(
        study.lateral_record(), {"roll": 0.02, "yaw": 0.005}, np.random.default_rng(1)
    )
    spectrum = gb.spectral.transient_spectrum(noisy, ["da", "dr"], ["roll", "yaw"], study.BAND)
    return gb.fit(gb.Problem(study.Lateral(), spectrum), starts=1, progress=False)


def test_the_panels_show_what_was_measured_fitted_and_left(fit):
    """Two panels for each output, one for each input; the marks are the numbers of the fit."""
    axes = gb.plotting.spectrum(fit)
    assert len(axes) == 6
    part = fit.spectra[0]
    measured, fitted, left, noise = (line.get_ydata() for line in axes[0].get_lines())
    np.testing.assert_allclose(measured, np.abs(part.data.outputs["roll"]))
    np.testing.assert_allclose(fitted, np.abs(part.fitted["roll"]))
    np.testing.assert_allclose(left, np.abs(part.residual("roll")))
    phase, near = (line.get_ydata() for line in axes[1].get_lines())
    np.testing.assert_allclose(np.exp(1j * np.radians(phase)), part.data.outputs["roll"] / measured)
    np.testing.assert_allclose(np.exp(1j * np.radians(near)), part.fitted["roll"] / fitted)
    assert np.abs(near - phase).max() <= 180
    assert np.abs(np.diff(phase)).max() <= 180
    # Of white noise, |error|² has the mean that is drawn.
    assert np.mean(left**2) == pytest.approx(noise[0] ** 2, rel=1e-6)
    np.testing.assert_allclose(axes[4].get_lines()[0].get_ydata(), np.abs(part.data.inputs["da"]))
    assert len(gb.plotting.spectrum(part.data)[0].get_lines()) == 1


def test_the_overview_has_the_manoeuvre(fit):
    """Its panels, and those of the starts."""
    assert len(gb.plot(fit).get_axes()) == 7


def test_what_cannot_be_drawn_is_said(fit):
    """With the cure."""
    with pytest.raises(TypeError, match="give a Fit or a TransientSpectrum"):
        gb.plotting.spectrum("fit")
    with pytest.raises(ValueError, match="there is no manoeuvre 1"):
        gb.plotting.spectrum(fit, part=1)
    with pytest.raises(ValueError, match=r"no manoeuvre 0: the fit has 0, .* gb\.plot draws"):
        gb.plotting.spectrum(replace(fit, name="plain", parts=()))
