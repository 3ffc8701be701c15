"""Exports of a multirotor: the numbers in the files, and the simulators where they are installed."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.models.multirotor import Rotation, rotor_places
from greybox.models.multirotor_export import to_mjcf, to_rotorpy

ROTORS = rotor_places((6, 0.2))
MODEL = Rotation(ROTORS)
VALUES = MODEL.values(
    m=1.4, c_1=0.5, c_2=6.0, j_x=0.004, j_y=0.005, s_z=0.9, k_m=0.02, T_rotor=0.03
)


def accelerations(command):
    """Return linear and angular accelerations at rest, by sums over the rotors."""
    x, y, direction = np.transpose(ROTORS)
    f = 0.5 * command + 6.0 * command**2
    moment = np.array([y @ f, -x @ f, -0.02 * direction @ f])
    return f.sum() - gb.g, moment / [0.004, 0.005, 0.9 * 0.009]


def hover():
    return (-0.5 + np.sqrt(0.25 + 24 * gb.g / 6)) / 12


def test_mjcf_has_mass_inertia_lag_and_thrust_about_hover():
    tree = ET.fromstring(to_mjcf(MODEL, VALUES))
    inertial = tree.find(".//inertial")
    assert float(inertial.get("mass")) == 1.4
    J = [float(v) for v in inertial.get("diaginertia").split()]
    assert_allclose(J, [1.4 * 0.004, 1.4 * 0.005, 1.4 * 0.9 * 0.009])
    motors = tree.findall(".//general")
    assert len(motors) == len(tree.findall(".//body/site")) - 1 == 6
    gain, bias = float(motors[0].get("gainprm")), float(motors[0].get("biasprm"))
    assert_allclose(6 * (gain * hover() + bias), 1.4 * gb.g)
    assert_allclose(gain, 1.4 * (0.5 + 12 * hover()))
    assert {float(motor.get("dynprm")) for motor in motors} == {0.03}


def test_mujoco_accelerates_as_the_model():
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(to_mjcf(MODEL, VALUES))
    command = hover() + 1e-5 * np.array([1, -2, 3, 1, -1, 2])
    data = mujoco.MjData(model)
    data.ctrl[:] = data.act[:] = command
    mujoco.mj_forward(model, data)
    linear, angular = accelerations(command)
    assert_allclose(data.qacc[2], linear, rtol=2e-3, atol=1e-7)
    assert_allclose(data.qacc[3:6], angular, rtol=2e-3, atol=1e-6)


def test_rotorpy_reads_its_dictionary():
    names = {}
    rotors = rotor_places((4, 0.2))
    exec(to_rotorpy(Rotation(rotors), VALUES), names)
    p = names["quad_params"]
    assert (p["num_rotors"], p["mass"], p["tau_m"]) == (4, 1.4, 0.03)
    speed = 1000 * (-0.5 + np.sqrt(0.25 + 24 * gb.g / 4)) / 12
    assert_allclose(4 * p["k_eta"] * speed**2, 1.4 * gb.g)
    # The yaw moment of a rotor is k_m times its direction times its squared speed.
    for k, (x, y, direction) in enumerate(rotors, 1):
        assert_allclose(p["rotor_pos"][f"r{k}"], [x, y, 0])
        yaw = p["k_m"] * p["rotor_directions"][k - 1]
        assert_allclose(yaw / p["k_eta"], -0.02 * direction)
    multirotor = pytest.importorskip("rotorpy.vehicles.multirotor")
    vehicle = multirotor.Multirotor(p)
    speeds = speed * np.array([1.01, 0.99, 1.02, 1.0])
    state = {name: np.zeros(3) for name in ("x", "v", "w", "wind")}
    state |= {"q": np.array([0, 0, 0, 1.0]), "rotor_speeds": speeds}
    later = vehicle.step(state, {"cmd_motor_speeds": speeds}, 1e-3)
    x, y, direction = np.transpose(rotors)
    f = gb.g / 4 * (speeds / speed) ** 2  # per mass
    moment = np.array([y @ f, -x @ f, -0.02 * direction @ f])
    assert_allclose(later["v"][2], 1e-3 * (f.sum() - gb.g), atol=1e-5)
    assert_allclose(later["w"], 1e-3 * moment / [0.004, 0.005, 0.0081], rtol=1e-2, atol=1e-6)


def test_rotorpy_has_four_rotors():
    with pytest.raises(ValueError, match="four rotors"):
        to_rotorpy(MODEL, VALUES)
