"""Spectra of manoeuvres: measured and fitted transforms of the outputs, what is left of them, and the inputs."""

import numpy as np

from greybox.estimate.fitted_part import FittedSpectrum
from greybox.files.text_table import in_greek
from greybox.html_report.figure import Figure, Panel, Series
from greybox.plotting.spectrum import integral_unit

GRAY, BLACK = -1, -2


def spectrum_figure(part: FittedSpectrum) -> Figure:
    """Return the magnitudes of the transforms of one manoeuvre, logarithmic."""
    data = part.data
    panels = []
    for name in part.outputs:
        scale, unit = integral_unit(data, name)
        series = [
            Series("what is left", "points", data.omega, scale * np.abs(part.residual(name)), GRAY),
            Series("measured", "points", data.omega, scale * np.abs(data.outputs[name]), BLACK),
            Series(f"fit of {part.label}", "line", data.omega, scale * np.abs(part.fitted[name])),
        ]
        panels.append(Panel(f"{in_greek(name)}, {unit}", series, is_logarithmic=True))
    for name, values in data.inputs.items():
        scale, unit = integral_unit(data, name)
        drawn = [Series("", "line", data.omega, scale * np.abs(values), BLACK)]
        panels.append(Panel(f"{in_greek(name)}, {unit}", drawn, height=0.6, is_logarithmic=True))
    title = f"Spectrum of the manoeuvre{f', {data.name}' if data.name else ''}"
    caption = "Magnitudes of the Fourier integrals; what is left should scatter about the same size at all frequencies."
    return Figure(title, "ω, rad/s", panels, caption, is_logarithmic=True)
