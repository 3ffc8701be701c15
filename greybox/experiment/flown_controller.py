"""The controller that a log shows, and whether it reproduces the logged control.

Begin with `FlownController`; `greybox.models.firmware.from_log` makes one.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from greybox.data.record import Record, Recording
from greybox.experiment.controller import Controller, updated
from greybox.files.arrays import Array
from greybox.files.text_table import one_line
from greybox.logs.named_columns import in_si
from greybox.modeling.one_thread import one_thread_at_a_time

LATEST = 3  # samples by which a logged setpoint may precede the control that it belongs to
SETTLED = 1.0  # s, until filters have forgotten that they began at zero

# Of the control. A tenth is 1 dB of loop gain or 6 degrees of phase, as much as a good interval;
# a half is half a margin, of which nothing remains to be said.
GOOD, REFUSED = 0.1, 0.5


@dataclass(frozen=True, eq=False)
class FlownController:
    """Controllers of one axis with the gains that flew, and the log signals of the last of them.

    Attributes
    ----------
    controllers : tuple of Controller
        In the order in which they run; `gb.margins` takes them.
    axis : str
    signals : mapping of str to str
        Own inputs, setpoints and output of the last controller to signals of the log, such as
        ``{"q": "RATE.P", "u": "RATE.POut"}``. Setpoints that the log does not have are zero.
    notes : tuple of str
        What the log names and the controllers leave out.
    """

    controllers: tuple[Controller, ...]
    axis: str
    signals: Mapping[str, str]
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        laws = [
            f"{type(c).__name__}: {', '.join(f'{n} {v:.4g}' for n, v in c.values.items())}"
            for c in self.controllers
        ]
        rate = f"{self.axis}, {self.controllers[-1].rate:g} Hz"
        return "\n".join([f"Controllers of {rate}, gains from the log:", *laws, *self.notes])


@dataclass(frozen=True, eq=False)
class ControlCheck:
    """The logged control, and the control that a controller computes from the logged error.

    Attributes
    ----------
    time, logged, predicted : (n,) arrays
        Without the mean of their difference, the integral at the start of the log.
    residual : float
        Root mean square of the difference over that of the control.
    late : mapping of setpoint to int
        Samples of the loop between the log of each setpoint and its effect on the control.
    log_rate, rate : float, Hz
        Of the log and of the controller.
    """

    time: Array = field(repr=False)
    logged: Array = field(repr=False)
    predicted: Array = field(repr=False)
    residual: float
    late: Mapping[str, int]
    log_rate: float
    rate: float

    @property
    def reproduces(self) -> bool:
        """Whether the controller computes the logged control to a tenth."""
        return self.residual <= GOOD

    def __repr__(self) -> str:
        return one_line(self, f"residual {100 * self.residual:.2g} %")

    def __str__(self) -> str:
        thinned = self.rate > 1.2 * self.log_rate
        log = f"; the log has {self.log_rate:.4g} of {self.rate:g} Hz" if thinned else ""
        verdict = f"Residual {100 * self.residual:.2g} % of the logged control{log}: the controller"
        if self.reproduces:
            return f"{verdict} reproduces it."
        cure = (
            "log every pass of the loop"
            if thinned
            else "check gains, filters and the scaling of the control"
        )
        return f"{verdict} does not reproduce it; {cure}."


def check_controller(
    flown: FlownController, recording: Recording, start: float = -math.inf, end: float = math.inf
) -> ControlCheck:
    """Simulate the last controller on the logged error, and compare its control with the log.

    A log may have only some passes of the loop: signals are then interpolated by cubic splines.

    Raises
    ------
    ValueError
        If the log lacks the error or the control, or if half of the control is not reproduced:
        margins would be those of another controller.
    """
    law = flown.controllers[-1]
    record = _logged(flown, recording, start, end)
    output = record[law.outputs[0]]
    # A log of every pass has the samples themselves, whatever its time stamps.
    thinned = law.rate > 1.2 * record.rate
    passes = math.ceil(record.duration * law.rate) + 1
    grid = record.time[0] + np.arange(passes) / law.rate if thinned else record.time
    n = len(grid)
    rows = _samples(record, law, grid)

    late = dict.fromkeys([name for name in law.setpoints if name in record.signals], 0)
    simulate = _compiled(law).mapaccum("flown", n)
    best, predicted = math.inf, np.zeros(n)
    settled = record.time > record.time[0] + min(SETTLED, record.duration / 2)
    size = float(np.std(output[settled]))
    if not size > 0:
        raise ValueError(f"{flown.signals[law.outputs[0]]} does not change: the loop was open.")

    # The delay of one setpoint moves the best of another: go through them twice.
    for name in [*late, *list(late)[:-1]] or [""]:
        for samples in range(LATEST + 1):
            trial = late | ({name: samples} if name else {})
            shifted = [np.roll(row, trial.get(key, 0)) for key, row in rows.items()]
            _, control = simulate(law.initial, np.array(shifted))
            at_rows = np.interp(record.time, grid, np.asarray(control)[0])
            error = float(np.std((output - at_rows)[settled])) / size
            if error < best:
                best, predicted, late = error, at_rows, trial
    if best > REFUSED:
        raise ValueError(
            f"{type(law).__name__} with the gains of the log does not reproduce "
            f"{flown.signals[law.outputs[0]]}: {100 * best:.0f} % of it remains; check that the "
            "log is of this firmware and the control of this axis."
        )
    offset = float(np.mean((output - predicted)[settled]))
    late = {name: samples for name, samples in late.items() if name}
    return ControlCheck(
        record.time[settled],
        output[settled],
        (predicted + offset)[settled],
        best,
        late,
        record.rate,
        law.rate,
    )


def _logged(flown: FlownController, recording: Recording, start: float, end: float) -> Record:
    """Return the signals of the last controller in SI, at the times of the logged control."""
    law = flown.controllers[-1]
    columns, units = {}, {}
    base = None
    for own in (*law.outputs[:1], *law.inputs, *law.setpoints):
        if own not in flown.signals:
            continue
        try:
            record, name = recording.locate(flown.signals[own])
        except KeyError as error:
            if own in law.setpoints[1:]:
                continue
            raise ValueError(f"the log cannot show its control law: {error.args[0]}") from None
        record = in_si(record, [name])
        if base is None:
            base = max(record.between(start, end).pieces, key=len)
        # The same message needs no interpolation, and its samples stay as they are.
        same = len(record) >= len(base) and np.isin(base.time, record.time).all()
        values = (
            record[name][np.isin(record.time, base.time)]
            if same
            else np.interp(base.time, record.time, record[name])
        )
        columns[own], units[own] = (
            np.where(np.isfinite(values), values, 0.0),
            record.units.get(name, ""),
        )
    assert base is not None
    return Record(base.time, columns, units)


def _samples(record: Record, law: Controller, grid: Array) -> dict[str, Array]:
    """Return what the controller reads at every pass of the loop."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415  (takes a tenth of a second to import)

    rows = {}
    for name in (*law.inputs, *law.setpoints):
        values = record.signals.get(name)
        rows[name] = (
            np.zeros(len(grid)) if values is None else CubicSpline(record.time, values)(grid)
        )
    return rows


@one_thread_at_a_time
def _compiled(law: Controller) -> ca.Function:
    x = ca.SX.sym("x", len(law.states))
    u = ca.SX.sym("u", len(law.inputs) + len(law.setpoints))
    names = (*law.inputs, *law.setpoints)
    following, outputs = updated(law, x, dict(zip(names, ca.vertsplit(u), strict=True)))
    return ca.Function("law", [x, u], [following, outputs[0]])
