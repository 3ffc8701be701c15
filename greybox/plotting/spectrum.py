"""Fourier integrals of a manoeuvre: measured and fitted outputs, what is left of them, and the inputs."""

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from greybox.data.transient_spectrum import TransientSpectrum
from greybox.estimate.fitted_part import FittedSpectrum
from greybox.estimate.result import Fit
from greybox.files.arrays import Array, ComplexArray
from greybox.files.text_table import counted
from greybox.plotting.style import (
    COLORS,
    DARK,
    TITLE_SIZE,
    AxesArray,
    GivenAxes,
    align_and_explain,
    chosen,
    finish,
    given_axes,
    label_horizontal,
    new_figure,
    plain,
    shown_unit,
    stacked,
    symbol,
)

WIDTH = 7.0  # inches
LEFT = "0.55"  # color of what is left


@dataclass(frozen=True, eq=False)
class Drawn:
    """A spectrum as it is drawn, with its fit where there is one."""

    data: TransientSpectrum
    fitted: FittedSpectrum | None
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]


def spectrum(
    item: Fit | TransientSpectrum, part: int = 0, axes: GivenAxes | None = None, legend: bool = True
) -> AxesArray:
    """Draw the transforms of a manoeuvre over omega in rad/s: magnitude and phase of outputs, magnitude of inputs.

    Of a fit the modelled outputs with the effect of the ends, what is left, and the size that white
    noise of the estimated deviation has: what is left should scatter about it at every frequency.

    Parameters
    ----------
    item : Fit or TransientSpectrum
    part : int
        Which manoeuvre of a fit to several.
    axes : array-like of Axes, optional
        Two for each output and one for each input. Without it a new figure is made.
    legend : bool
        False leaves the legend out. It stands below a new figure, and in the first panel of given
        axes.

    Returns
    -------
    numpy.ndarray of Axes, shape (2 * outputs + inputs,)
        The last line of a notebook cell is ``gb.plotting.spectrum(fit)[0].figure``.

    Raises
    ------
    TypeError, ValueError
        For what cannot be drawn, a fit without a manoeuvre, or a wrong number of axes.
    """
    drawn = as_drawn(item, part)
    if axes is not None:
        names = [panel for name in drawn.outputs for panel in (name, f"phase of {name}")]
        places = given_axes(axes, [*names, *drawn.inputs], "this spectrum")
    else:
        places = spectrum_axes(new_figure(WIDTH, spectrum_height(drawn)), drawn)
    draw_spectrum(places, drawn)
    align_and_explain(places, spectrum_legend(drawn), given=axes is not None, legend=legend)
    return places


def as_drawn(item: Fit | TransientSpectrum, part: int = 0) -> Drawn:
    """Return what is drawn.

    Raises
    ------
    TypeError, ValueError
        For what cannot be drawn, or a fit without a manoeuvre of this number.
    """
    if isinstance(item, TransientSpectrum):
        return Drawn(item, None, tuple(item.outputs), tuple(item.inputs))
    if not isinstance(item, Fit):
        raise TypeError(f"cannot draw {item!r:.80}: give a Fit or a TransientSpectrum.")
    if not item.spectra:
        raise ValueError(f"the fit {item.name!r} has no manoeuvre: draw it with gb.plot.")
    fitted = chosen(item.spectra, part, "manoeuvre")
    return Drawn(fitted.data, fitted, fitted.outputs, tuple(fitted.data.inputs))


def spectrum_height(drawn: Drawn) -> float:
    """Return the height in inches that a figure needs."""
    return 1.3 + 3.3 * len(drawn.outputs) + 1.3 * len(drawn.inputs)


def spectrum_axes(figure: Figure | SubFigure, drawn: Drawn) -> AxesArray:
    """Make the axes in a figure or a part of one: magnitude and phase of each output, then the inputs."""
    heights = [
        *(height for _ in drawn.outputs for height in (2.2, 1.1)),
        *(1.2 for _ in drawn.inputs),
    ]
    return stacked(figure, heights)


def draw_spectrum(places: AxesArray, drawn: Drawn) -> None:
    """Draw into the panels."""
    for k, name in enumerate(drawn.outputs):
        _draw_output(places[2 * k], places[2 * k + 1], drawn, name)
    for ax, name in zip(places[2 * len(drawn.outputs) :], drawn.inputs, strict=True):
        scale, unit = integral_unit(drawn.data, name)
        ax.plot(
            drawn.data.omega,
            scale * np.abs(drawn.data.inputs[name]),
            "o-",
            **_points(DARK),
            linewidth=0.9,
        )
        ax.set_ylim(bottom=0)
        finish(ax, f"|{symbol(name)}|, {plain(unit)}")
    about = f"{counted(len(drawn.data), 'line')}, {drawn.data.duration:.4g} s"
    places[0].set_title(plain(f"{drawn.data.name or 'manoeuvre'}: {about}"), fontsize=TITLE_SIZE)
    label_horizontal(places, "ω, rad/s")


def spectrum_legend(drawn: Drawn) -> dict[str, tuple[Artist, ...]]:
    """Return the legend."""
    keys: dict[str, tuple[Artist, ...]] = {
        "measured": (Line2D([], [], linestyle="none", marker="o", **_points(DARK)),)
    }
    if drawn.fitted is not None:
        keys[plain(f"fit of {drawn.fitted.label}")] = (
            Line2D([], [], color=COLORS[0], linewidth=1.6),
        )
        keys["measured less fitted"] = (
            Line2D([], [], linestyle="none", marker="x", color=LEFT, markersize=5),
        )
        if _has_noise(drawn.fitted):
            keys["size of the noise"] = (Line2D([], [], color=LEFT, linewidth=1.1, linestyle="--"),)
    return keys


def _draw_output(ax: Axes, phase_ax: Axes, drawn: Drawn, name: str) -> None:
    data, fitted, omega = drawn.data, drawn.fitted, drawn.data.omega
    scale, unit = integral_unit(data, name)
    measured = data.outputs[name]
    ax.semilogy(omega, scale * _size(measured), "o", **_points(DARK), zorder=2.4)
    phase = np.degrees(np.unwrap(np.angle(measured)))
    phase_ax.plot(omega, phase, "o", **_points(DARK), zorder=2.4)
    if fitted is not None:
        values = fitted.fitted[name]
        ax.semilogy(omega, scale * _size(values), color=COLORS[0], linewidth=1.6)
        ax.semilogy(omega, scale * _size(measured - values), "x", color=LEFT, markersize=5)
        # Next to the measured phase, wherever that was unwrapped to.
        phase_ax.plot(
            omega, phase + np.degrees(np.angle(values / measured)), color=COLORS[0], linewidth=1.6
        )
        if _has_noise(fitted):
            k = fitted.outputs.index(name)
            level = math.sqrt(float(fitted.noise[k, k]) * data.step * data.duration)
            ax.axhline(scale * level, color=LEFT, linewidth=1.1, linestyle="--")
    finish(ax, f"|{symbol(name)}|, {plain(unit)}")
    finish(phase_ax, f"∠{symbol(name)}, °")
    phase_ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 3, 4.5, 6, 9, 10]))


def _has_noise(fitted: FittedSpectrum) -> bool:
    """Tell whether the noise that was estimated is that of the outputs."""
    return fitted.criterion == "output-error" and bool(np.all(np.isfinite(fitted.noise)))


def _size(values: ComplexArray) -> Array:
    """Return magnitudes, NaN for zero, which has no logarithm."""
    size = np.abs(values)
    return np.where(size > 0, size, np.nan)


def _points(color: str) -> dict:
    return {"color": color, "markersize": 4, "markerfacecolor": "white"}


def integral_unit(data: TransientSpectrum, name: str) -> tuple[float, str]:
    """Return the factor to the unit that a person reads, and that unit of the integral."""
    scale, unit = shown_unit(data.units.get(name, ""))
    return scale, "s" if unit in ("", "1") else f"({unit}) s"
