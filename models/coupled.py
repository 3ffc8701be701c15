"""Roll rate coupled with the sideways velocity: ODEs (2.9), (2.11) and their transfer functions."""

import greybox as gb

PAPER_G = 9.8065  # m/s², the value of the paper, below (4.24)


class CoupledVelocity(gb.StateSpace):
    r"""Roll rate and sideways velocity from the roll control, (2.9).

    $$\begin{bmatrix} \dot v \\ \dot p \\ \dot\phi \end{bmatrix} =
    \begin{bmatrix} a_1 & 0 & g \\ a_2 & 0 & 0 \\ 0 & 1 & 0 \end{bmatrix}
    \begin{bmatrix} v \\ p \\ \phi \end{bmatrix} +
    \begin{bmatrix} b_1 \\ b_2 \\ 0 \end{bmatrix} u_\phi(t - T_{delay})$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.9).
    """

    states = ("v", "p", "phi")
    inputs = ("u",)
    outputs = ("p", "phi", "v")
    units = {"p": "rad/s", "phi": "rad", "v": "m/s"}
    delays = {"u": "T_delay"}
    a1 = gb.Parameter(-0.2, bounds=(-50, 50), unit="1/s", about="drag on the velocity")
    a2 = gb.Parameter(
        -5.0, bounds=(-50, 50), unit="1/(m·s)", about="angular acceleration per velocity"
    )
    b1 = gb.Parameter(0.0, bounds=(-50, 50), unit="m/s²", about="acceleration per control")
    b2 = gb.Parameter(
        300.0, bounds=(1, 5000), unit="1/s²", about="angular acceleration per control, K̃"
    )
    T_delay = gb.Parameter(0.005, bounds=(0, 0.05), unit="s", about="controller and ESC delay")
    derived = {
        "b1_tilde": lambda p: p.a2 * p.b1 / p.b2 - p.a1,
        "a2_tilde": lambda p: -p.a1,
        "a0_tilde": lambda p: -PAPER_G * p.a2,
    }

    def derivative(self, x, u, p) -> tuple:  # with a rotor it is longer
        return (p.a1 * x.v + PAPER_G * x.phi + p.b1 * u.u, p.a2 * x.v + p.b2 * u.u, x.p)

    def output(self, x, u, p):
        return (x.p, x.phi, x.v)


class LaggedCoupledVelocity(CoupledVelocity):
    r"""Roll rate and sideways velocity from the roll control, (2.9) behind the rotor (2.4).

    $$T_\Omega \dot w = u_\phi(t - T_{delay}) - w, \qquad
    \begin{bmatrix} \dot v \\ \dot p \\ \dot\phi \end{bmatrix} =
    \begin{bmatrix} a_1 & 0 & g \\ a_2 & 0 & 0 \\ 0 & 1 & 0 \end{bmatrix}
    \begin{bmatrix} v \\ p \\ \phi \end{bmatrix} +
    \begin{bmatrix} b_1 \\ b_2 \\ 0 \end{bmatrix} w$$

    The model of reference [7] of the paper: the rotors follow the control as a first-order lag.
    With $b_1 = 0$, and stiffness and damping in addition, it is `LinearTilt`.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, below (2.9).
    """

    states = ("v", "p", "phi", "w")
    T_rotor = gb.Parameter(0.05, bounds=(0.001, 1), unit="s", about="rotor time constant T_Ω")

    def derivative(self, x, u, p):
        return (
            p.a1 * x.v + PAPER_G * x.phi + p.b1 * x.w,
            p.a2 * x.v + p.b2 * x.w,
            x.p,
            (u.u - x.w) / p.T_rotor,
        )


class CoupledVelocityTransfer(gb.TransferFunction):
    r"""Roll rate from the roll control, the transfer function of (2.9).

    $$P_p(s) = \frac{\tilde K s (s + \tilde b_1)}{s^3 + \tilde a_2 s^2 + \tilde a_0} e^{-s
    T_{delay}}$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, below (2.9).
    """

    input, output = "u", "p"
    K_tilde = gb.Parameter(
        300.0, bounds=(1, 5000), unit="1/s²", about="angular acceleration per control"
    )
    b1_tilde = gb.Parameter(0.2, bounds=(-100, 100), unit="1/s", about="zero at s = -b̃1")
    a2_tilde = gb.Parameter(0.2, bounds=(-50, 50), unit="1/s", about="coefficient of s²")
    a0_tilde = gb.Parameter(50.0, bounds=(-500, 500), unit="1/s³", about="constant coefficient")
    T_delay = gb.Parameter(0.005, bounds=(0, 0.05), unit="s", about="controller and ESC delay")

    def response(self, s, p):
        denominator = s**3 + p.a2_tilde * s**2 + p.a0_tilde
        return p.K_tilde * s * (s + p.b1_tilde) / denominator * gb.exp(-s * p.T_delay)


class DampedCoupledVelocity(gb.StateSpace):
    r"""Roll rate and sideways velocity from the roll control, with the rate acting on both, (2.11).

    $$\begin{bmatrix} \dot v \\ \dot p \\ \dot\phi \end{bmatrix} = \begin{bmatrix} a_{11} & a_{12} &
    g \\ a_{21} & a_{22} & 0 \\ 0 & 1 & 0 \end{bmatrix} \begin{bmatrix} v \\ p \\ \phi \end{bmatrix}
    + \begin{bmatrix} 0 \\ b_2 \\ 0 \end{bmatrix} u_\phi$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.11).
    """

    states = ("v", "p", "phi")
    inputs = ("u",)
    outputs = ("p", "phi", "v")
    units = {"p": "rad/s", "phi": "rad", "v": "m/s"}
    a11 = gb.Parameter(-0.2, bounds=(-50, 50), unit="1/s", about="drag on the velocity")
    a12 = gb.Parameter(0.1, bounds=(-50, 50), unit="m/s", about="acceleration per roll rate")
    a21 = gb.Parameter(
        -5.0, bounds=(-50, 50), unit="1/(m·s)", about="angular acceleration per velocity"
    )
    a22 = gb.Parameter(-1.0, bounds=(-50, 50), unit="1/s", about="damping of the roll rate")
    b2 = gb.Parameter(
        300.0, bounds=(1, 5000), unit="1/s²", about="angular acceleration per control, K̃"
    )
    derived = {
        "b1_tilde": lambda p: -p.a11,
        "a2_tilde": lambda p: -(p.a11 + p.a22),
        "a1_tilde": lambda p: p.a11 * p.a22 - p.a12 * p.a21,
        "a0_tilde": lambda p: -PAPER_G * p.a21,
    }

    def derivative(self, x, u, p):
        return (
            p.a11 * x.v + p.a12 * x.p + PAPER_G * x.phi,
            p.a21 * x.v + p.a22 * x.p + p.b2 * u.u,
            x.p,
        )

    def output(self, x, u, p):
        return (x.p, x.phi, x.v)


class DampedCoupledVelocityTransfer(gb.TransferFunction):
    r"""Roll rate from the roll control, (2.12), the transfer function of (2.11).

    $$P_p(s) = \frac{\tilde K s (s + \tilde b_1)}{s^3 + \tilde a_2 s^2 + \tilde a_1 s + \tilde
    a_0}$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.12).
    """

    input, output = "u", "p"
    units = {"p": "rad/s"}
    K_tilde = gb.Parameter(
        300.0, bounds=(1, 5000), unit="1/s²", about="angular acceleration per control"
    )
    b1_tilde = gb.Parameter(0.2, bounds=(-50, 50), unit="1/s", about="zero at s = -b̃1")
    a2_tilde = gb.Parameter(1.0, bounds=(-100, 100), unit="1/s", about="coefficient of s²")
    a1_tilde = gb.Parameter(1.0, bounds=(-500, 500), unit="1/s²", about="coefficient of s")
    a0_tilde = gb.Parameter(50.0, bounds=(-500, 500), unit="1/s³", about="constant coefficient")

    def response(self, s, p):
        denominator = s**3 + p.a2_tilde * s**2 + p.a1_tilde * s + p.a0_tilde
        return p.K_tilde * s * (s + p.b1_tilde) / denominator
