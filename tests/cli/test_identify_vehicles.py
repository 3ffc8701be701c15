"""`greybox identify` on an aircraft's table, with sensor noise: the truth within its errors."""

import json

import numpy as np
import pytest
from command_line import run
from linear_simulation import lsim

pytestmark = pytest.mark.usefixtures("undrawn")

RATE, FINE, DELAY = 25, 10, 0.02


def chirp(time, low=0.1, high=2.0):
    """Return a logarithmic chirp from 3 to 55 s."""
    growth = np.log(high / low)
    share = np.clip((time - 3) / 52, 0, 1)
    phase = 2 * np.pi * low * 52 / growth * np.expm1(growth * share)
    return np.clip(np.minimum(share, 1 - share) * 30, 0, 1) * np.sin(phase)


def test_a_dutch_roll_is_identified_by_the_family_of_fixed_wings(capsys, tmp_path):
    """The yaw rate is called r, as setpoints are in other tables."""
    truth = {"N": -4.0, "z": 0.425, "omega_d": 2.51, "zeta_d": 0.22, "T_delay": DELAY}
    mode = [1, 2 * truth["zeta_d"] * truth["omega_d"], truth["omega_d"] ** 2]
    fine = np.arange(0, 60, 1 / RATE / FINE)
    rate = lsim((truth["N"] * np.array([1, truth["z"]]), mode), 3 * chirp(fine - DELAY), fine)
    time = fine[::FINE]
    rate = rate[::FINE] + 0.15 * np.random.default_rng(0).standard_normal(time.size)
    table = np.column_stack([1000 * time, 3 * chirp(time), rate])
    np.savetxt(
        tmp_path / "a.csv", table, delimiter=",", header="millis,dr [deg],r [deg/s]", comments=""
    )
    pair = ("--input", "dr", "--output", "r", "--whole", "--vehicle", "fixed-wing")
    options = ("--points", "15", "--starts", "3", "--json", "--out", tmp_path / "x")
    status, out, error = run(capsys, "identify", tmp_path / "a.csv", *pair, *options)
    assert status == 0, error
    answer = json.loads(out)
    assert [s["model"] for s in answer["structures"] if s["chosen"]] == ["fixed_wing:DutchRoll"]
    fit = answer["fit"]
    for name, value in truth.items():
        assert abs(fit["estimate"][name] - value) < 3 * fit["standard_error"][name], name
