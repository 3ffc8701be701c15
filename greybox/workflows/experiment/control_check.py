"""Whether a controller reproduces the logged control from the logged error."""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

from greybox.data.files.public import public
from greybox.data.record import Record
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.symbolic_reading import entries_by_name
from greybox.workflows.experiment.controller import Controller, updated

THINNED = 1.2  # rate of the loop over that of the log, above which passes are missing

# Shares of the control. A tenth is 1 dB of loop gain or 6 degrees of phase, as much as a good
# interval; if half remains, the margins are those of another controller.
GOOD, REFUSED = 0.1, 0.5


@public
@dataclass(frozen=True)
class ControlCheck:
    """How far a controller reproduces a logged control.

    Attributes
    ----------
    residual : float
        Root mean square of the difference over that of the control, means removed.
    late : mapping of setpoint to int
        Samples of the loop between the log of each setpoint and its effect on the control.
    log_rate, rate : float, Hz
        Rates of the log and of the controller.
    """

    residual: float
    late: Mapping[str, int]
    log_rate: float
    rate: float

    @property
    def reproduces(self) -> bool:
        """Whether the controller computes the logged control to a tenth."""
        return self.residual <= GOOD

    def __str__(self) -> str:
        is_thinned = self.rate > THINNED * self.log_rate
        log = f", logged at {self.log_rate:.4g} Hz of {self.rate:g} Hz" if is_thinned else ""
        cure = "log every pass of the loop" if is_thinned else "check gains, filters and scaling"
        verdict = "reproduces it." if self.reproduces else f"does not reproduce it: {cure}."
        return f"Residual {100 * self.residual:.2g} % of the control{log}: the controller {verdict}"


@public
def check_controller(controller: Controller, record: Record) -> ControlCheck:
    """Simulate a controller on the logged error, and compare its first output with the log.

    Parameters
    ----------
    controller : Controller
    record : Record
        Inputs, setpoints and the first output by the controller's own names; a setpoint that is
        not there is zero. Its first minute or so is used. Where a log has only some passes of the
        loop, the signals are interpolated by cubic splines.

    Returns
    -------
    ControlCheck

    Raises
    ------
    ValueError
        If the control does not change, or if half of it is not reproduced.
    """
    passes = controller.rate * record.step
    # A minute of the loop at 400 Hz: more would not change the answer.
    record = record.rows(slice(max(int(24000 / max(passes, 1)), 2)))
    time = record.time
    name = controller.outputs[0]
    logged = record[name]
    signals = {n: record[n] for n in controller.inputs}
    signals |= {n: record.signals.get(n, np.zeros(len(time))) for n in controller.setpoints}
    grid = time  # a log of every pass has the samples themselves, whatever its time stamps
    if controller.rate > THINNED * record.rate:
        grid = time[0] + np.arange(math.ceil(record.duration * controller.rate)) / controller.rate
        signals = {n: CubicSpline(time, values)(grid) for n, values in signals.items()}
    simulate = _compiled(controller).mapaccum("flown", len(grid))

    # After a second, filters have forgotten that they began at zero.
    settled = time > time[0] + min(1.0, record.duration / 2)
    size = float(np.std(logged[settled]))
    if not size > 0:
        raise ValueError(f"the logged control {name} does not change: the loop was open.")
    delayed = [n for n in controller.setpoints if n in record.signals]
    best = math.inf
    late = {}
    # A logged setpoint may precede the control that it belongs to by up to three samples.
    for samples in itertools.product(range(4), repeat=len(delayed)):
        trial = dict(zip(delayed, samples, strict=True))
        shifted = [np.roll(row, trial.get(n, 0)) for n, row in signals.items()]
        _, control = simulate(controller.initial, np.array(shifted))
        computed = np.interp(time, grid, np.asarray(control)[0])
        residual = float(np.std((logged - computed)[settled])) / size
        if residual < best:
            best, late = residual, trial
    if best > REFUSED:
        raise ValueError(
            f"{type(controller).__name__} does not reproduce the logged {name}: {100 * best:.0f} % "
            "of it remains; check that the gains and the log are of this controller and axis."
        )
    return ControlCheck(best, late, record.rate, controller.rate)


@one_thread_at_a_time
def _compiled(controller: Controller) -> ca.Function:
    names = (*controller.inputs, *controller.setpoints)
    x, u = ca.SX.sym("x", len(controller.states)), ca.SX.sym("u", len(names))
    following, outputs = updated(controller, x, entries_by_name(names, u))
    return ca.Function("law", [x, u], [following, outputs[0]])
