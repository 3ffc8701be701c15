"""Angular rate of one axis as a transfer function: structures (2.5) to (2.8) and (2.10)."""

import greybox as gb


class BasicRate(gb.TransferFunction):
    r"""Roll rate from the roll control: rotor lag and inertia only, (2.5).

    $$P_p(s) = \frac{K_\phi}{s (T_\Omega s + 1)} e^{-s T_{delay}}, \qquad
    K_\phi = \frac{4 K_\tau \Omega_F K_\Omega}{J_x}$$

    The factor 4 refers to the control $u_\phi$: the torque (2.3) gives $8 K_\tau \Omega_F$ per
    common speed change $\Omega_\phi$ of the rotors, and the mixer below (2.3) passes half of
    $u_\phi$ to each.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.5).
    """

    input, output = "u", "p"
    units = {"p": "rad/s"}
    K_phi = gb.Parameter(
        300.0, bounds=(0, 5000), unit="1/s²", about="angular acceleration per control"
    )
    T_rotor = gb.Parameter(0.05, bounds=(0.001, 1), unit="s", about="rotor time constant T_Ω")
    T_delay = gb.Parameter(0.005, bounds=(0, 0.05), unit="s", about="controller and ESC delay")

    def response(self, s, p):
        return p.K_phi / (s * (p.T_rotor * s + 1)) * gb.exp(-s * p.T_delay)


class BasicAngle(BasicRate):
    r"""Roll angle from the roll control: rotor lag and inertia only, (2.6).

    $$P_\phi(s) = \frac{K_\phi}{s^2 (T_\Omega s + 1)} e^{-s T_{delay}}$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.6).
    """

    input, output = "u", "phi"
    units = {"phi": "rad"}

    def response(self, s, p):
        return super().response(s, p) / s


class DampedAngle(gb.TransferFunction):
    r"""Angle from the control: rotor lag, inertia and rate damping, (2.6) with one more term.

    $$P_\phi(s) = \frac{K_\phi}{s (s + a) (T_\Omega s + 1)} e^{-s T_{delay}}$$

    The air damps the rotation, but translation causes no torque, as in many simulators.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.6).
    """

    input, output = "u", "theta"
    units = {"theta": "rad"}
    K_phi = gb.Parameter(
        100.0, bounds=(1, 2000), unit="1/s²", about="angular acceleration per control"
    )
    a = gb.Parameter(1.0, bounds=(0, 5), unit="1/s", about="damping of the rate")
    T_rotor = gb.Parameter(0.05, bounds=(0.001, 0.2), unit="s", about="rotor time constant T_Ω")
    T_delay = gb.Parameter(0.005, bounds=(0, 0.05), unit="s", about="controller and ESC delay")

    def response(self, s, p):
        return p.K_phi / (s * (s + p.a) * (p.T_rotor * s + 1)) * gb.exp(-s * p.T_delay)


class LaggedAngle(gb.TransferFunction):
    r"""Angle from the control: one integrator with lag and delay.

    $$P(s) = \frac{K}{s (T s + 1)} e^{-s T_{delay}}$$

    The simplest structure for a vehicle whose rate follows the control, as with strong damping.

    Source: Tischler and Remple, Aircraft and Rotorcraft System Identification, 2nd ed., chapter 11.
    """

    input, output = "u", "theta"
    units = {"theta": "rad"}
    K = gb.Parameter(10.0, bounds=(0, 2000), unit="1/s", about="rate per control")
    T = gb.Parameter(0.2, bounds=(0.001, 20), unit="s", about="time constant of the rate")
    T_delay = gb.Parameter(0.005, bounds=(0, 0.05), unit="s", about="controller and ESC delay")

    def response(self, s, p):
        return p.K / (s * (p.T * s + 1)) * gb.exp(-s * p.T_delay)


class LaggedRate(LaggedAngle):
    r"""Rate from the control: a lag with a delay, (2.8).

    $$P(s) = \frac{K}{T s + 1} e^{-s T_{delay}}$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.8).
    """

    output = "q"
    units = {"q": "rad/s"}

    def response(self, s, p):
        return super().response(s, p) * s


class DampedRotation(DampedAngle):
    r"""Rate from the control: rotor lag, inertia and rate damping, (2.5) with one more term.

    $$P(s) = \frac{K_\phi}{(s + a) (T_\Omega s + 1)} e^{-s T_{delay}}$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.5).
    """

    output = "q"
    units = {"q": "rad/s"}

    def response(self, s, p):
        return super().response(s, p) * s


class DampedRate(gb.TransferFunction):
    r"""Roll rate from the roll control: one real pole and a complex pair, (2.7).

    $$P_p(s) = \frac{K_1 s}{(T_1 s + 1)(s^2 + 2 \xi \omega_p s + \omega_p^2)} e^{-s T_{delay}}$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.7).
    """

    input, output = "u", "p"
    units = {"p": "rad/s"}
    K_1 = gb.Parameter(100.0, bounds=(0, 5000), unit="1/s²", about="gain")
    T_1 = gb.Parameter(0.2, bounds=(0.001, 10), unit="s", about="time constant of the real pole")
    xi = gb.Parameter(
        0.1, bounds=(-2, 2), unit="1", about="damping ratio ξ, negative when unstable"
    )
    omega_p = gb.Parameter(3.0, bounds=(0.01, 50), unit="rad/s", about="natural frequency")
    T_delay = gb.Parameter(0.005, bounds=(0, 0.05), unit="s", about="controller and ESC delay")

    def response(self, s, p):
        oscillation = s**2 + 2 * p.xi * p.omega_p * s + p.omega_p**2
        return p.K_1 * s / ((p.T_1 * s + 1) * oscillation) * gb.exp(-s * p.T_delay)


class YawRateLag(gb.TransferFunction):
    r"""Yaw rate from the yaw control: a first-order lag, (2.8).

    $$P_r(s) = \frac{K_2}{T_2 s + 1} e^{-s T_{delay}}$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.8).
    """

    input, output = "u", "r"
    units = {"r": "rad/s"}
    K_2 = gb.Parameter(10.0, bounds=(0, 1000), unit="1/s", about="gain")
    T_2 = gb.Parameter(1.0, bounds=(0.001, 100), unit="s", about="time constant of the yaw rate")
    T_delay = gb.Parameter(0.005, bounds=(0, 0.05), unit="s", about="controller and ESC delay")

    def response(self, s, p):
        return p.K_2 / (p.T_2 * s + 1) * gb.exp(-s * p.T_delay)


class YawRateLead(YawRateLag):
    r"""Yaw rate from the yaw control: a lead and the rotor lag, (2.10).

    $$P_r(s) = \frac{K_2 (T_{lead} s + 1)}{(T_2 s + 1)(T_\Omega s + 1)} e^{-s T_{delay}}$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.10).
    """

    T_lead = gb.Parameter(0.2, bounds=(0, 10), unit="s", about="lead time constant")
    T_rotor = gb.Parameter(0.05, bounds=(0.001, 1), unit="s", about="rotor time constant T_Ω")

    def response(self, s, p):
        return super().response(s, p) * (p.T_lead * s + 1) / (p.T_rotor * s + 1)
