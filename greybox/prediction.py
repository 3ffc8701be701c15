"""What a model predicts over windows of a record, with what was measured there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from greybox.record import Record
from greybox.table import counted, number, text_table
from greybox.validation import fit_percent, rms

Array = NDArray[np.float64]
AHEAD = (0.1, 0.25, 0.5, 1.0)  # shares of the horizon at which the growth of the error is told


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predictions of k outputs over w windows of h samples. Printing it says how good they are.

    Attributes
    ----------
    label : str
        Name of the model.
    data : Record
        What was measured.
    inputs, outputs, states : tuple of str
    lead, horizon : float
        Lengths in s.
    rows : (w, h) int array
        Indices in `data` of the predicted samples; sample j is j + 1 steps after the last one that informed it.
    predicted, error : (k, w, h) arrays
        Of the outputs as their sensors show them, and the standard errors: of the parameters (with the states that
        they imply, first order) and of the state at the beginning. The noise of the outputs comes on top.
    noise : (k, k) array
        Covariance of the outputs' errors, that of the fit or else estimated from the lead-ins.
    trajectory : (n, w, h) array
        The states.
    one_step : (k, w, h) array
        Errors of predictions one sample ahead, from all that the window had measured before, in units of the standard
        deviations that they should have: white with unit variance for the right model. NaN where nothing was measured.
    """

    label: str
    data: Record
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    states: tuple[str, ...]
    lead: float
    horizon: float
    rows: NDArray[np.integer]
    predicted: Array
    error: Array
    noise: Array
    trajectory: Array
    one_step: Array

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def ahead(self) -> Array:
        """How far ahead each sample of a window is predicted (h,), s."""
        return self.data.step * np.arange(1, self.rows.shape[1] + 1)

    @property
    def record(self) -> Record:
        """Outputs, their standard errors ``<output>_error`` and states at the data's times, NaN outside the windows.

        A state that bears the name of an output is given once, as the output.
        """
        signals, units = {}, {}
        for k, name in enumerate(self.outputs):
            signals |= {name: self._spread(self.predicted[k]), f"{name}_error": self._spread(self.error[k])}
            units |= dict.fromkeys((name, f"{name}_error"), self.data.units.get(name, ""))
        for i, name in enumerate(self.states):
            if name not in signals:
                signals[name] = self._spread(self.trajectory[i])
                units[name] = self.data.units.get(name, "")
        return Record(self.data.time, signals, units, name=f"{self.label}, {self.horizon:g} s ahead")

    def measured(self, output: str) -> Array:
        """Return what was measured in the windows, (w, h), NaN where nothing was."""
        self._place(output)
        return self.data[output][self.rows]

    def residual(self, output: str) -> Array:
        """Return measured less predicted, (w, h)."""
        return self.measured(output) - self.predicted[self._place(output)]

    def band(self, output: str, level: float = 0.95, noise: bool = False) -> tuple[Array, Array]:
        """Return the limits, (w, h) each, within which the output lies at this level; with `noise`, its measurement.

        They take the model's structure as right and all errors as normal. What disturbs the plant besides its inputs
        (wind) and a correlation of the sensors' errors in time widen the truth beyond them.
        """
        if not 0 < level < 1:
            raise ValueError(f"level {level} must lie between 0 and 1, e.g. 0.95.")
        from scipy.special import ndtri  # noqa: PLC0415  (takes a tenth of a second to import)

        k = self._place(output)
        half = float(ndtri(0.5 + level / 2)) * np.sqrt(self.error[k] ** 2 + (self.noise[k, k] if noise else 0.0))
        return self.predicted[k] - half, self.predicted[k] + half

    def rms(self, output: str, share: float | None = None) -> float:
        """Return the root mean square error over all samples, or at one share (0 to 1] of the horizon."""
        e = self.residual(output)
        if share is not None:
            e = e[:, max(1, math.ceil(share * e.shape[1] - 1e-9)) - 1]
        return rms(e)

    def fit_percent(self, output: str) -> float:
        """Return 100 (1 - |error| / |measured - mean|) over all windows."""
        return fit_percent(self.measured(output), self.predicted[self._place(output)])

    def _place(self, output: str) -> int:
        if output not in self.outputs:
            raise ValueError(f"{output!r} was not predicted; there is {', '.join(self.outputs)}.")
        return self.outputs.index(output)

    def _spread(self, values: Array) -> Array:
        result = np.full(len(self.data), np.nan)
        result[self.rows.ravel()] = values.ravel()
        return result

    def __str__(self) -> str:
        head = (
            f"{self.label}: {counted(len(self), 'window')} of {self.horizon:g} s in "
            f"{self.data.name or 'the record'}, the state of each from {self.lead:g} s before it"
        )
        ends = [f"after {number(s * self.horizon, 3)} s" for s in AHEAD]
        rows = [self._row(name) for name in self.outputs]
        table = text_table(
            ["output", "unit", "fit %", "error (rms)", *ends, "noise", "error as told"], rows, left=(0, 1)
        )
        return "\n".join([head, "", *("  " + line for line in table.splitlines())])

    def _row(self, name: str) -> Sequence[str]:
        k = self._place(name)
        grown = [number(self.rms(name, share), 3) for share in AHEAD]
        told = float(np.sqrt(np.mean(self.error[k] ** 2)))
        values = [number(self.fit_percent(name), 4), number(self.rms(name), 3), *grown]
        return [name, self.data.units.get(name, ""), *values, number(math.sqrt(self.noise[k, k]), 3), number(told, 3)]
