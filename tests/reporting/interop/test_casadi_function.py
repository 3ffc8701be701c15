"""A model at its estimate as a CasADi function."""

import casadi as ca
import numpy as np
from declared_models import TILT, TILT_OMEGA

import greybox as gb
from greybox.models.tilt import PAPER_G, NonlinearTilt, Tilt

VALUES = {**TILT, "T_rotor": 0.05, "T_delay": 0.0, "C_x": 0.3}


def test_the_casadi_function_is_the_formula():
    f = gb.interop.to_casadi(NonlinearTilt(), VALUES)
    assert f.name_in() == ["x", "u"]
    assert f.name_out() == ["derivative", "y"]
    v, q, theta, rotor, u = 3.0, 0.2, 0.1, 0.05, 0.4
    derivative, y = f([v, q, theta, rotor], u)
    by_hand = [
        PAPER_G * np.tan(theta) - VALUES["C_x"] * abs(v) * v,
        -VALUES["a1"] * theta - VALUES["a2"] * q - VALUES["a3"] * v + VALUES["a4"] * rotor,
        q,
        (u - rotor) / VALUES["T_rotor"],
    ]
    np.testing.assert_allclose(derivative.full().ravel(), by_hand)
    np.testing.assert_allclose(y.full().ravel(), [theta, v])


def test_the_casadi_function_of_a_transfer_function_has_its_response():
    f = gb.interop.to_casadi(Tilt(), {**TILT, "T_delay": 0.02}, pade=2)
    x, u = ca.SX.sym("x", f.size1_in(0)), ca.SX.sym("u")
    blocks = ca.Function("blocks", [], [ca.jacobian(out, by) for out in f(x, u) for by in (x, u)])()
    A, B, C, D = (np.asarray(ca.DM(block)) for block in blocks.values())
    found = [(C @ np.linalg.solve(1j * w * np.eye(len(A)) - A, B) + D)[0, 0] for w in TILT_OMEGA]
    expected = gb.frequency_response(
        Tilt(), {**TILT, "T_delay": 0.02}, TILT_OMEGA, delay="pade:2"
    ).response
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_the_casadi_function_has_the_name_of_the_model_in_letters_of_c():
    class RollRate(Tilt):
        label = "roll rate, 5°"

    assert gb.interop.to_casadi(Tilt(), TILT, pade=0).name() == "Tilt"
    assert gb.interop.to_casadi(RollRate(), TILT, pade=0).name().strip("_") == "roll_rate_5"
