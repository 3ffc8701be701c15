"""The vehicle: its equations against vectors and rotations of NumPy and SciPy, and simulated flights."""

import numpy as np
import pytest
from evaluation import random_values
from numpy.testing import assert_allclose
from scipy.spatial import transform

import greybox as gb
from greybox.modeling.formula_arguments import Names
from greybox.modeling.trim import derivative_function
from greybox.models.multirotor import Multirotor, Rotation, regular_frame

IRREGULAR = ((0.12, -0.1, 1), (-0.15, -0.08, -1), (-0.1, 0.13, 1), (0.2, 0.11, -1), (0.0, 0.2, 1))
FREE = ("c_1", "delta_p", "delta_q", "delta_r", "h", "a5", "C_x", "b_rotor", "x_a", "z_a")


def by_vectors(model, p, x, u):
    """Return derivative and accelerometer of a vehicle with a quaternion, by vectors."""
    v, quaternion, omega, w = x[:3], x[3:7], x[7:10], x[10:]
    R = transform.Rotation.from_quat(quaternion[[1, 2, 3, 0]]).as_matrix()
    f = p["c_0"] + p["c_1"] * w + p["c_2"] * w**2
    rising = (u - w) / p["T_rotor"]
    moment = np.zeros(3)
    for (x_k, y_k, d), thrust, rate in zip(model.rotors, f, rising, strict=True):
        moment += np.cross([x_k, y_k, 0], [0, 0, thrust])
        moment -= np.array([0, 0, d * (p["k_m"] * thrust + p["h"] * rate)])
    j = np.array([p["j_x"], p["j_y"], p["s_z"] * (p["j_x"] + p["j_y"])])
    turning = (moment - np.cross(omega, j * omega)) / j + [p["delta_p"], p["delta_q"], p["delta_r"]]
    body = R.T @ v
    across = p["a5"] + p["b_rotor"] * w.sum()
    linear = np.array([across, across, p["a5_z"]]) * body
    force = np.array([0, 0, f.sum()]) - linear - p["C_x"] * np.abs(body) * body * [1, 1, 0]
    imaginary = transform.Rotation.from_quat(quaternion[[1, 2, 3, 0]])
    # The derivative of a quaternion is half its product with the rates.
    qw, qv = imaginary.as_quat()[3], imaginary.as_quat()[:3]
    attitude = np.array([-qv @ omega, *(qw * omega + np.cross(qv, omega))]) / 2
    place = np.array([p["x_a"], p["y_a"], p["z_a"]])
    felt = force + np.cross(turning, place) + np.cross(omega, np.cross(omega, place))
    return np.concatenate([R @ force - [0, 0, gb.g], attitude, turning, rising]), felt


@pytest.mark.parametrize("rotors", [4, IRREGULAR])
def test_the_equations_in_vectors(rotors):
    model, random = Multirotor(rotors, "quaternion"), np.random.default_rng(0)
    count = len(model.rotors)
    for _ in range(5):
        p = random_values(model, random)
        quaternion = transform.Rotation.random(random_state=random).as_quat()[[3, 0, 1, 2]]
        if quaternion[0] < 0:
            quaternion = -quaternion
        x = np.concatenate([random.normal(size=3), quaternion, random.normal(size=3)])
        x, u = np.concatenate([x, random.uniform(0, 1, count)]), random.uniform(0, 1, count)
        derivative, felt = by_vectors(model, p, x, u)
        ours = derivative_function(model)(np.concatenate([x, u]), list(p.values()))
        assert_allclose(np.asarray(ours).ravel(), derivative, rtol=1e-9, atol=1e-9)
        names = dict(zip((*model.states, *model.inputs), np.concatenate([x, u]), strict=True))
        outputs = model.output(Names(names), Names(names), model.values(p))
        assert_allclose([float(y) for y in outputs[-3:]], felt, rtol=1e-9, atol=1e-9)


def test_angles_and_quaternion_describe_one_flight():
    time = np.arange(0, 2, 0.005)
    commands = 0.7 + 0.02 * np.array([np.sin(k * time) for k in (3, 4, 5, 6)])
    record = gb.Record(time, dict(zip(("u_1", "u_2", "u_3", "u_4"), commands, strict=True)))
    values = {"c_2": gb.g / 4 / 0.49, "a5": 0.4, "j_x": 0.01, "j_y": 0.02, "C_x": 0.1}
    flown = [
        gb.simulate(Multirotor(4, attitude, True), values, record, initial=initial)
        for attitude, initial in (("angles", {}), ("quaternion", {"q_w": 1.0}))
    ]
    for name in ("x", "y", "z", "p", "r", "a_x", "a_z"):
        assert_allclose(flown[0][name], flown[1][name], atol=1e-6)
        assert np.ptp(flown[0][name]) > 1e-3
    angles = transform.Rotation.from_quat(
        np.array([flown[1][f"q_{k}"] for k in "xyzw"]).T
    ).as_euler("ZYX")
    assert_allclose(angles.T, [flown[0][k] for k in ("psi", "theta", "phi")], atol=1e-6)


@pytest.mark.parametrize("number", [4, 6, 8])
def test_a_regular_frame_hovers_and_turns_about_each_axis(number):
    """More thrust on the left rolls to the right, and in front lifts the nose (pitch is negative)."""
    model = Multirotor(number)
    system = gb.modeling.linearize(model, {"c_1": 1.0})
    assert_allclose(sum(1.0 * w + 5.0 * w**2 for w in [system.point["w_1"]] * number), gb.g)
    rates = system.A[:3, 3:]
    x, y, direction = np.transpose(regular_frame(number, 0.1))
    for moment in (rates[0] * y, -rates[1] * x, -rates[2] * direction):
        assert np.all(moment > 0)
    assert_allclose(rates.sum(axis=1), 0, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"attitude": "euler"}, "attitude = 'euler': give 'angles'"),
        ({"position": True}, "a position needs an attitude"),
        ({"rotors": 1}, "rotors = 1: give at least two"),
        ({"rotors": ((0.1, 0.1), (0.2, 0.2))}, "each as"),
    ],
)
def test_refuses(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        Multirotor(**arguments)


def test_no_trim_but_hover():
    with pytest.raises(ValueError, match="is hover"):
        gb.modeling.linearize(Multirotor(4, "angles"), {}, at={"theta": 0.1})


def test_without_yaw_there_is_no_moment_of_it():
    tilt, yaw = Rotation(4, axes="qp"), Rotation(4, axes="r")
    assert tilt.states[:2] == ("p", "q")
    assert tilt.inputs[-1] == "r"
    assert not {"k_m", "h", "delta_r"} & {*tilt.parameters}
    assert "J_z" in yaw.derived
    assert "J_z" not in tilt.derived
    with pytest.raises(ValueError, match="axes = 'x'"):
        Rotation(4, axes="x")


def test_measured_speeds_have_no_lag():
    model = Multirotor(4, "quaternion", speeds=True)
    assert not {"T_rotor", "T_delay", "h"} & {*model.parameters}
    assert len(model.states) == 10
    p = {"c_2": gb.g / 4 / 0.25, "j_x": 2e-3, "j_y": 3e-3}
    record = gb.Record(
        np.arange(0, 1, 0.01), {f"Omega_{k}": 0.5 + 0 * np.arange(100) for k in range(1, 5)}
    )
    flown = gb.simulate(model, p, record, initial={"q_w": 1.0})
    assert_allclose(flown["a_z"], gb.g)
    assert_allclose(flown["v_z"], 0, atol=1e-9)
