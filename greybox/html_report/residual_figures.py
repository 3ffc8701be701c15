"""Residuals of fitted records: how they are correlated with themselves and with the inputs."""

from collections.abc import Iterator

import numpy as np

from greybox.estimate.fitted_part import FittedRecord
from greybox.files.text_table import in_greek
from greybox.html_report.figure import Figure, Panel, Series
from greybox.plotting.residuals import residual_panels
from greybox.statistics.metrics import CorrelationTest
from greybox.validation.comparison import p_text

GRAY = -1


def residual_figures(part: FittedRecord) -> Iterator[Figure]:
    """Yield for every output the correlations of its residuals with themselves and with inputs; none without a time."""
    for output in part.outputs:
        panels = []
        told = []
        for panel in residual_panels(part, output):
            if panel.test is None or not np.isfinite(panel.test.correlations).any():
                continue
            itself = panel.name == "autocorrelation"
            name = "Autocorrelation" if itself else f"Correlation with {in_greek(panel.name)}"
            told.append(
                f"with {'themselves' if itself else panel.name} {p_text(panel.test.p_value)}"
            )
            panels.append(_correlations(name, panel.test))
        if panels:
            caption = (
                "99 % of single correlations stay within the band if there is none. Probability of these by chance: "
                f"{', '.join(told)}."
            )
            where = f", {part.data.name}" if part.data.name else ""
            yield Figure(
                f"Residuals of {in_greek(output)}{where}",
                "Lag, samples",
                panels,
                caption,
                is_whole=True,
            )


def _correlations(name: str, test: CorrelationTest) -> Panel:
    lags = np.arange(1.0, len(test.correlations) + 1)
    bound = np.full(lags.size, test.bound)
    most = 1.25 * max(float(np.nanmax(np.abs(test.correlations), initial=0.0)), test.bound)
    below, above = np.minimum(test.correlations, 0), np.maximum(test.correlations, 0)
    series = [
        Series("99 % bound", "band", lags, -bound, GRAY, low=-bound, high=bound),
        Series("", "rule", np.zeros(1), np.zeros(1), GRAY),
        Series("", "points", lags, test.correlations, low=below, high=above),
    ]
    return Panel(name, series, height=0.7, limits=(-most, most))
