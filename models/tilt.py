"""Roll and pitch angle with velocity feedback: (4.25), and its ODEs (4.23) and (4.24)."""

import greybox as gb

PAPER_G = 9.8065  # m/s², the value of the paper, below (4.24)


class TiltParameters:
    """Parameters of all three forms of the tilt dynamics: (4.23) without drag, rotor (4.22)."""

    a1 = gb.Parameter(
        0.0, bounds=(-100, 100), unit="1/s²", about="stiffness: angular acceleration per angle"
    )
    a2 = gb.Parameter(3.0, bounds=(-50, 50), unit="1/s", about="damping of the angular velocity")
    a3 = gb.Parameter(
        5.0, bounds=(-50, 50), unit="1/(m·s)", about="angular acceleration per velocity"
    )
    a4 = gb.Parameter(
        250.0, bounds=(1, 2000), unit="1/s²", about="angular acceleration per control, ã4"
    )
    T_rotor = gb.Parameter(
        0.048, bounds=(0.001, 1), unit="s", about="rotor time constant T_Ω", fixed=True
    )
    T_delay = gb.Parameter(
        0.0042, bounds=(0, 0.05), unit="s", about="controller and ESC delay", fixed=True
    )
    derived = {"a3_tilde": lambda p: PAPER_G * p.a3}


def _tilt(s, p):
    tilt = (s + p.a5) / ((s + p.a5) * (s**2 + p.a2 * s + p.a1) + gb.g * p.a3)
    return p.a4 * tilt / (p.T_rotor * s + 1) * gb.exp(-s * p.T_delay)


class Tilt(TiltParameters, gb.TransferFunction):
    r"""Tilt angle from the tilt control, (4.25).

    $$P_\theta(s) = \frac{\tilde a_4 (s + a_5)}
    {(T_\Omega s + 1)((s + a_5)(s^2 + a_2 s + a_1) + \tilde a_3)} e^{-s T_{delay}},
    \qquad \tilde a_3 = g a_3$$

    The parameter `a4` is $\tilde a_4$, which includes the torque gain.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (4.25).
    """

    input, output = "u", "theta"
    units = {"theta": "rad"}
    a5 = gb.Parameter(
        0.16, bounds=(0, 10), unit="1/s", about="drag on the velocity, (4.24)", fixed=True
    )

    def response(self, s, p):
        tilt = (s + p.a5) / ((s + p.a5) * (s**2 + p.a2 * s + p.a1) + PAPER_G * p.a3)
        return p.a4 * tilt / (p.T_rotor * s + 1) * gb.exp(-s * p.T_delay)


class TiltRate(TiltParameters, gb.TransferFunction):
    r"""Rate of the tilt angle from the tilt control, (4.25) times s.

    $$P_q(s) = \frac{\tilde a_4 s (s + a_5)}
    {(T_\Omega s + 1)((s + a_5)(s^2 + a_2 s + a_1) + \tilde a_3)} e^{-s T_{delay}}$$

    With $T_\Omega = 0$ and no delay it is (2.12).

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.12) and (4.25).
    """

    input, output = "u", "q"
    units = {"q": "rad/s"}
    a5 = Tilt.a5

    def response(self, s, p):
        return _tilt(s, p) * s


class LinearTilt(TiltParameters, gb.StateSpace):
    r"""Tilt angle and velocity from the tilt control with linear drag, (4.23) with (4.24).

    $$\dot v = g \theta - a_5 v, \quad \dot q = -a_1 \theta - a_2 q - a_3 v + a_4 \tau_\theta, \quad
    \dot\theta = q, \quad \dot\tau_\theta = (u(t - T_{delay}) - \tau_\theta) / T_\Omega$$

    The rotor state represents the torque; `a4` includes the torque gain. The transfer function is
    `Tilt`.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (4.21), (4.23) and
    (4.24).
    """

    states = ("v", "q", "theta", "rotor")
    inputs = ("u",)
    outputs = ("theta", "v")
    units = {"theta": "rad", "v": "m/s"}
    delays = {"u": "T_delay"}
    a5 = Tilt.a5

    def derivative(self, x, u, p):
        return (
            PAPER_G * x.theta - p.a5 * x.v,
            -p.a1 * x.theta - p.a2 * x.q - p.a3 * x.v + p.a4 * x.rotor,
            x.q,
            (u.u - x.rotor) / p.T_rotor,
        )

    def output(self, x, u, p):
        return (x.theta, x.v)


class NonlinearTilt(TiltParameters, gb.StateSpace):
    r"""Tilt angle and velocity from the tilt control with quadratic drag, (4.23).

    $$\dot v = g \tan\theta - C_x |v| v, \quad \dot q = -a_1 \theta - a_2 q - a_3 v + a_4
    \tau_\theta, \quad \dot\theta = q, \quad \dot\tau_\theta = (u(t - T_{delay}) - \tau_\theta) /
    T_\Omega$$

    The rotor state represents the torque; `a4` includes the torque gain. In hover the slope of the
    drag is zero, so `C_x` vanishes from the linearization there. Records identify it.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (4.21) and (4.23).
    """

    states = ("v", "q", "theta", "rotor")
    inputs = ("u",)
    outputs = ("theta", "v")
    units = {"theta": "rad", "v": "m/s"}
    delays = {"u": "T_delay"}
    C_x = gb.Parameter(
        0.05, bounds=(0.001, 2), unit="1/m", about="drag per squared velocity", scale="log"
    )

    def derivative(self, x, u, p):
        return (
            PAPER_G * gb.tan(x.theta) - p.C_x * abs(x.v) * x.v,
            -p.a1 * x.theta - p.a2 * x.q - p.a3 * x.v + p.a4 * x.rotor,
            x.q,
            (u.u - x.rotor) / p.T_rotor,
        )

    def output(self, x, u, p):
        return (x.theta, x.v)
