"""Rotor speed: a first-order lag with a delay, (2.4) and (4.21)."""

import greybox as gb


class Rotor(gb.TransferFunction):
    r"""Rotor speed from the control of one motor, (4.21); without the delay, (2.4).

    $$P_\Omega(s) = \frac{K_\Omega}{T_\Omega s + 1} e^{-s T_{delay}}$$

    The delay is due to the controller and the ESC, which work in discrete time.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (4.21).
    """

    input, output = "u", "Omega"
    K_Omega = gb.Parameter(1000.0, bounds=(0, 5000), unit="rad/s", about="rotor speed per control")
    T_rotor = gb.Parameter(0.05, bounds=(0.001, 1), unit="s", about="rotor time constant T_Ω")
    T_delay = gb.Parameter(0.005, bounds=(0, 0.05), unit="s", about="controller and ESC delay")

    def response(self, s, p):
        return p.K_Omega / (p.T_rotor * s + 1) * gb.exp(-s * p.T_delay)
