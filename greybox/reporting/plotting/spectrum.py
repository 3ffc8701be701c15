"""Fourier integrals of a manoeuvre: measured and fitted outputs, residuals, and the inputs."""

import math

import numpy as np

from greybox.assessment.fitted_part import FittedSpectrum
from greybox.assessment.result import Fit
from greybox.data.files.arrays import Array, ComplexArray, all_finite
from greybox.data.files.greek_letters import in_greek
from greybox.data.files.public import public
from greybox.data.files.wording import counted
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.reporting.plotting.figure import (
    ANGLES,
    CROSS,
    GRAY,
    INK,
    Figure,
    Panel,
    Series,
    require_drawable,
    rule,
)
from greybox.reporting.plotting.matplotlib_figure import AxesArray, GivenAxes, draw
from greybox.reporting.plotting.signals import chosen, shown_unit


@public
def spectrum(
    item: Fit | TransientSpectrum,
    part: int = 0,
    axes: GivenAxes | None = None,
    *,
    hz: bool = False,
) -> AxesArray:
    """Draw the transforms of a manoeuvre over omega in rad/s.

    Magnitude and phase of the outputs and magnitude of the inputs. For a fit also the modeled
    outputs, with the effect of the ends of the manoeuvre, the residuals, and the size of white
    noise of the estimated variance, around which the residuals should scatter at all frequencies.

    Parameters
    ----------
    item : Fit or TransientSpectrum
    part : int
        Number of the manoeuvre in a fit to several.
    axes : array-like of Axes, optional
        Two for each output and one for each input. By default a new figure is made.
    hz : bool
        Frequencies in Hz.

    Returns
    -------
    numpy.ndarray of Axes, shape (2 * outputs + inputs,)
        In a notebook, ``gb.plotting.spectrum(fit)[0].figure`` shows the figure.

    Raises
    ------
    TypeError, ValueError
        For an item that cannot be drawn, a fit without a manoeuvre, or a wrong number of axes.
    """
    return draw([spectrum_figure(item, part)], axes, size=(7.0, 2.5), hz=hz)


def spectrum_figure(item: Fit | TransientSpectrum, part: int) -> Figure:
    """Return the spectrum of one manoeuvre."""
    if isinstance(item, TransientSpectrum):
        data = item
        fitted = None
        outputs = tuple(data.outputs)
    else:
        require_drawable(item, Fit, "a Fit or a TransientSpectrum")
        fitted = chosen(item.spectra, part, "manoeuvre")
        data, outputs = fitted.data, fitted.outputs

    panels = [panel for name in outputs for panel in _output_panels(data, fitted, name)]
    for name, values in data.inputs.items():
        factor, unit = _unit(data, name)
        size = factor * np.abs(values)
        # The line shows the valleys, in which a manoeuvre contains no information.
        series = [Series("", "line", data.omega, size, INK), _measured(data, size)]
        limits = (0.0, 1.1 * float(size.max()) or 1.0)
        panels.append(Panel(f"|{in_greek(name)}|, {unit}", series, height=0.5, limits=limits))

    about = f"{counted(len(data), 'line')}, {data.duration:.4g} s"
    return Figure(
        f"Spectrum of the manoeuvre{f', {data.name}' if data.name else ''}",
        "ω, rad/s",
        panels,
        subject=f"{data.name or 'manoeuvre'}: {about}",
        caption="Fourier integrals. Residuals should have about the same size at all frequencies.",
    )


def _output_panels(
    data: TransientSpectrum, fitted: FittedSpectrum | None, name: str
) -> tuple[Panel, Panel]:
    omega = data.omega
    factor, unit = _unit(data, name)
    measured = data.outputs[name]
    angle = np.degrees(np.unwrap(np.angle(measured)))
    magnitude, phase = [_measured(data, factor * _size(measured))], [_measured(data, angle)]
    if fitted is not None:
        label = f"fit of {fitted.label}"
        values = fitted.fitted[name]
        magnitude.append(Series(label, "line", omega, factor * _size(values)))
        residual = factor * _size(measured - values)
        magnitude.append(Series("residual", "points", omega, residual, GRAY, CROSS))
        # Relative to the measured phase: both unwrapped separately could differ by whole turns.
        phase.append(Series(label, "line", omega, angle + np.degrees(np.angle(values / measured))))
        # Only output error estimates the noise of the outputs; equation error estimates that of
        # equations.
        if fitted.criterion == "output-error" and all_finite(fitted.noise):
            k = fitted.outputs.index(name)
            # The root mean square of the integral of white noise over the manoeuvre.
            level = math.sqrt(float(fitted.noise[k, k]) * data.step * data.duration)
            magnitude.append(rule(factor * level, "size of the noise", style=1))

    return (
        Panel(f"|{in_greek(name)}|, {unit}", magnitude, height=0.9, is_logarithmic=True),
        Panel(f"∠{in_greek(name)}, °", phase, height=0.5, steps=ANGLES),
    )


def _measured(data: TransientSpectrum, values: Array) -> Series:
    return Series("measured", "points", data.omega, values, INK, is_hollow=True)


def _size(values: ComplexArray) -> Array:
    """Return magnitudes, NaN for zero, which has no logarithm."""
    size = np.abs(values)
    return np.where(size > 0, size, np.nan)


def _unit(data: TransientSpectrum, name: str) -> tuple[float, str]:
    """Return the factor to the unit in the figure, and the unit of the integral."""
    factor, unit = shown_unit(data.units, name)
    return factor, "s" if unit in ("", "1") else f"({unit}) s"
