"""Yaw rate and yaw angle with one additional state: (4.33), (4.34) and (4.37)."""

import greybox as gb


class YawParameters:
    """Parameters common to the transfer functions of yaw rate and yaw angle."""

    a1_tilde = gb.Parameter(
        0.0, bounds=(-20000, 20000), unit="1/s²", about="feedback through ν, a1 K_ν"
    )
    a2 = gb.Parameter(100.0, bounds=(-100, 2000), unit="1/s", about="damping of the yaw rate")
    a3_tilde = gb.Parameter(
        500.0, bounds=(1, 10000), unit="1/s²", about="yaw acceleration per control"
    )
    a4 = gb.Parameter(1.0, bounds=(-50, 100), unit="1/s", about="decay of the state ν")
    T_rotor = gb.Parameter(
        0.048, bounds=(0.001, 1), unit="s", about="rotor time constant T_Ω", fixed=True
    )
    T_delay = gb.Parameter(
        0.0042, bounds=(0, 0.05), unit="s", about="controller and ESC delay", fixed=True
    )


def _rate(s, p):
    rate = p.a3_tilde * (s + p.a4) / ((s + p.a4) * (s + p.a2) + p.a1_tilde)
    return rate / (p.T_rotor * s + 1) * gb.exp(-s * p.T_delay)


class YawRate(YawParameters, gb.TransferFunction):
    r"""Yaw rate from the yaw control, (4.34).

    $$P_r(s) = \frac{\tilde a_3 (s + a_4)}
    {(T_\Omega s + 1)((s + a_4)(s + a_2) + \tilde a_1)} e^{-s T_{delay}}$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (4.34).
    """

    input, output = "u", "r"
    units = {"r": "rad/s"}

    def response(self, s, p):
        return _rate(s, p)


class YawAngle(YawParameters, gb.TransferFunction):
    r"""Yaw angle from the yaw control, (4.37): the integral of (4.34).

    $$P_\psi(s) = \frac{\tilde a_3 (s + a_4)}
    {s (T_\Omega s + 1)((s + a_4)(s + a_2) + \tilde a_1)} e^{-s T_{delay}}$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (4.37).
    """

    input, output = "u", "psi"
    units = {"psi": "rad"}

    def response(self, s, p):
        return _rate(s, p) / s


class YawStates(gb.StateSpace):
    r"""Yaw rate and yaw angle from the yaw control as an ODE, (4.33) with the rotor (4.21).

    $$\dot\nu = -a_4 \nu + K_\nu r, \quad \dot r = -a_1 \nu - a_2 r + a_3 \tau_\psi, \quad \dot\psi
    = r, \quad \dot\tau_\psi = (u(t - T_{delay}) - \tau_\psi) / T_\Omega$$

    The rotor state represents the torque; `a3` includes the torque gain. The yaw motion determines
    only the product $a_1 K_\nu$, so `K_nu` is fixed; it sets the unit of $\nu$. The transfer
    functions are `YawRate` and `YawAngle`.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (4.21) and (4.33).
    """

    states = ("nu", "r", "rotor", "psi")
    inputs = ("u",)
    outputs = ("r", "psi")
    units = {"r": "rad/s", "psi": "rad"}
    delays = {"u": "T_delay"}
    a1 = gb.Parameter(0.0, bounds=(-20000, 20000), unit="1/s²", about="yaw acceleration per ν")
    a2 = YawRate.a2
    a3 = gb.Parameter(
        500.0, bounds=(1, 10000), unit="1/s²", about="yaw acceleration per control, ã3"
    )
    a4 = YawRate.a4
    T_rotor = YawRate.T_rotor
    T_delay = YawRate.T_delay
    K_nu = gb.Parameter(1.0, bounds=(0, 10), unit="1", about="growth of ν per yaw rate", fixed=True)
    derived = {"a1_tilde": lambda p: p.a1 * p.K_nu, "a3_tilde": lambda p: p.a3}

    def derivative(self, x, u, p):
        return (
            -p.a4 * x.nu + p.K_nu * x.r,
            -p.a1 * x.nu - p.a2 * x.r + p.a3 * x.rotor,
            (u.u - x.rotor) / p.T_rotor,
            x.r,
        )

    def output(self, x, u, p):
        return (x.r, x.psi)
