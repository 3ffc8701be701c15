"""Spectra of manoeuvres: measured and fitted transforms of the outputs, what is left of them, and the inputs."""

import numpy as np

from greybox.data.text_table import in_greek
from greybox.estimate.fitted_part import FittedSpectrum
from greybox.html_report.figure import Figure, Panel, Series

GRAY, BLACK = -1, -2


def spectrum_figure(part: FittedSpectrum) -> Figure:
    """Return the magnitudes of the transforms of one manoeuvre, logarithmic."""
    data = part.data
    panels = []
    for name in part.outputs:
        unit = data.units.get(name, "")
        series = [
            Series("what is left", "points", data.omega, np.abs(part.residual(name)), GRAY),
            Series("measured", "points", data.omega, np.abs(data.outputs[name]), BLACK),
            Series(f"fit of {part.label}", "line", data.omega, np.abs(part.fitted[name])),
        ]
        label = f"{in_greek(name)}, {f'{unit}·s' if unit else 's'}"
        panels.append(Panel(label, series, is_logarithmic=True))
    for name, values in data.inputs.items():
        drawn = [Series("", "line", data.omega, np.abs(values), BLACK)]
        panels.append(Panel(in_greek(name), drawn, height=0.6, is_logarithmic=True))
    title = f"Spectrum of the manoeuvre{f', {data.name}' if data.name else ''}"
    caption = "Magnitudes of the Fourier integrals; what is left should scatter about the same size at all frequencies."
    return Figure(title, "ω, rad/s", panels, caption, is_logarithmic=True)
