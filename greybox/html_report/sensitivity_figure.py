"""Where the data tell of a parameter, and where a parameter moves the fitted response."""

import numpy as np

from greybox.estimate.fitted_part import FittedResponse
from greybox.estimate.response_band import response_and_slope
from greybox.estimate.result import Fit
from greybox.html_report.figure import Figure, Panel, Series
from greybox.modeling.model import Model

POINTS = 120  # frequencies: these curves are smooth, and every one costs an evaluation
STEP = 0.01  # of a parameter's value, for which the change is shown
COLORS = 6


def sensitivity_figure(fit: Fit, part: FittedResponse, model: Model) -> Figure | None:
    """Return by how much magnitude and phase change where a free parameter changes by one percent, to first order.

    None where no free parameter has a value other than zero.
    """
    curve = part.data if part.sine is not None or part.curve is None else part.curve
    omega = np.unique(curve.omega)
    omega = omega[
        np.unique(np.linspace(0, omega.size - 1, min(omega.size, POINTS)).round().astype(int))
    ]
    outside = {name: part.rename.get(name, name) for name in model.parameters}
    values = {name: fit.estimate[known_as] for name, known_as in outside.items()}
    signals = {"input": curve.input, "output": curve.output, "at": part.at, "delay": part.delay}
    response, slope = response_and_slope(
        model, values, omega, part.sine, part.data.omega, **signals
    )

    magnitude, phase = [], []
    for k, (name, known_as) in enumerate(outside.items()):
        if known_as not in fit.free or values[name] == 0:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            change = STEP * values[name] * slope[:, k] / response.response
        style, color = divmod(len(magnitude), COLORS)
        magnitude.append(
            Series(known_as, "line", omega, 20 / np.log(10) * np.real(change), color, style)
        )
        phase.append(Series(known_as, "line", omega, np.degrees(np.imag(change)), color, style))
    if not magnitude:
        return None
    panels = [Panel("Change of magnitude, dB", magnitude), Panel("Change of phase, °", phase)]
    caption = "Change of the fitted response where one parameter grows by 1 % and the others stay."
    return Figure("Sensitivity", "ω, rad/s", panels, caption, is_logarithmic=True)


def information_figure(fit: Fit, part: int) -> Figure | None:
    """Return what each frequency, or each time of a record, tells of every free parameter; None where it is not known.

    With the other parameters estimated along, and with the others known: where the second is high
    and the first is low, another parameter has the same effect.
    """
    try:
        found = fit.sensitivity(part)
    except ValueError:
        return None
    panels = []
    for label, shares in (("Others estimated, %", found.shares), ("Others known, %", found.alone)):
        series = []
        for k, name in enumerate(found.names):
            told = 100 * shares[k].sum(axis=0)
            if np.isfinite(told).any():
                style, color = divmod(len(series), COLORS)
                series.append(Series(name, "line", found.at, told, color, style))
        if series:
            panels.append(Panel(label, series, height=0.8))
    if not panels:
        return None
    data = fit.parts[part].data.name or fit.parts[part].name
    label = {"rad/s": "ω, rad/s", "s": "Time, s", "row": "Row"}[found.unit]
    caption = "Share of all that the data of the fit tell of a parameter, by the point or the part of the record it is in."
    title = f"What tells of each parameter{f', {data}' if data else ''}"
    return Figure(
        title,
        label,
        panels,
        caption,
        is_logarithmic=found.unit == "rad/s",
        is_wide=found.unit != "rad/s",
    )
