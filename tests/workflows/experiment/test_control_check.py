"""Whether a controller computes a logged control, and by how many samples a setpoint is late."""

import numpy as np
import pytest

import greybox as gb
from greybox.workflows.experiment import check_controller


class Damper(gb.Controller):
    """A rate loop with two commands."""

    inputs, setpoints, outputs = ("q",), ("reference", "trim"), ("u",)
    K = gb.Parameter(0.3)

    def update(self, x, u, p):
        return (), (p.K * (u.reference - u.q) + u.trim,)


@pytest.fixture
def log():
    """The reference acts two samples after its log, the trim one sample."""
    random = np.random.default_rng(0)
    q, reference, trim = random.normal(size=(3, 1200)).cumsum(axis=1)
    control = 0.3 * (np.roll(reference, 2) - q) + np.roll(trim, 1)
    signals = {"q": q, "reference": reference, "trim": trim, "u": control}
    return gb.Record(np.arange(1200) / 400, signals)


def test_late_setpoints_are_found_together(log):
    checked = check_controller(Damper(), log)
    assert checked.reproduces
    assert checked.residual < 1e-9
    assert checked.late == {"reference": 2, "trim": 1}
    assert "reproduces it" in str(checked)


def test_a_controller_with_other_gains_is_refused(log):
    with pytest.raises(ValueError, match="does not reproduce the logged u"):
        check_controller(Damper({"K": -3.0}), log)


def test_a_setpoint_that_was_not_logged_is_zero(log):
    signals = {name: log[name] for name in ("q", "reference")}
    signals["u"] = 0.3 * (log["reference"] - log["q"])
    checked = check_controller(Damper(), gb.Record(log.time, signals))
    assert checked.late == {"reference": 0}
    assert checked.residual < 1e-9
