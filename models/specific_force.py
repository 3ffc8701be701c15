"""Specific force on a multicopter: thrust along the rotor axis, drag across it."""

import greybox as gb


class RotorThrust(gb.StateSpace):
    r"""Specific force along the rotor axis from the mean motor command and the battery voltage.

    $$T_{rotor} \dot w = u - w, \quad a_z = c_0 + c_u w + c_V V$$

    The thrust is linear in command and voltage near hover, and follows the command with the lag of
    the rotors. All terms are divided by the mass.

    Source: Taylor series of the thrust about hover.
    """

    states = ("w",)
    inputs = ("u", "V")
    outputs = ("a_z",)
    units = {"u": "1", "V": "V", "a_z": "m/s²"}
    T_rotor = gb.Parameter(0.05, bounds=(0.005, 0.5), unit="s", about="rotor time constant")
    c_0 = gb.Parameter(-15.0, bounds=(-100, 100), unit="m/s²", about="specific force at the origin")
    c_u = gb.Parameter(20.0, bounds=(0, 100), unit="m/s²", about="thrust per mass and command")
    c_V = gb.Parameter(2.0, bounds=(-20, 20), unit="m/s²/V", about="thrust per mass and voltage")

    def derivative(self, x, u, p):
        return ((u.u - x.w) / p.T_rotor,)

    def output(self, x, u, p):
        return (p.c_0 + p.c_u * x.w + p.c_V * u.V,)


class BodyDrag(gb.StateSpace):
    r"""Specific force across the rotor axis: linear and quadratic drag on the body velocity.

    $$a_x = -a_5 v_x - C_x |v_x| v_x, \quad a_y = -a_5 v_y - C_x |v_y| v_y$$

    An accelerometer measures the drag without gravity, so no tilt angle is needed. The delay is
    that of its low-pass filter, if the velocity has none.

    Source: the drag terms of (4.23) and (4.24), equal along both axes.
    """

    states = ()
    inputs = ("v_x", "v_y")
    outputs = ("a_x", "a_y")
    delays = {"v_x": "T_delay", "v_y": "T_delay"}
    units = {"v_x": "m/s", "v_y": "m/s", "a_x": "m/s²", "a_y": "m/s²"}
    a5 = gb.Parameter(0.2, bounds=(-1, 5), unit="1/s", about="linear drag on the velocity, (4.24)")
    C_x = gb.Parameter(0.05, bounds=(-1, 2), unit="1/m", about="drag per squared velocity, (4.23)")
    T_delay = gb.Parameter(0.01, bounds=(0, 0.2), unit="s", about="accelerometer behind velocity")

    def derivative(self, x, u, p):
        return ()

    def output(self, x, u, p):
        return tuple(-p.a5 * v - p.C_x * abs(v) * v for v in (u.v_x, u.v_y))
