"""Modes of a fixed-wing aircraft: short period, phugoid, roll mode and dutch roll."""

import greybox as gb


def _mode(s, zeta, omega):
    return s**2 + 2 * zeta * omega * s + omega**2


class ShortPeriod(gb.TransferFunction):
    r"""Pitch rate from the elevator: short period.

    $$\frac{q}{\delta_e} = \frac{M (s + 1/T_{\theta 2})}
    {s^2 + 2 \zeta_{sp} \omega_{sp} s + \omega_{sp}^2} e^{-s T_{delay}}$$

    Source: McRuer, Ashkenas and Graham, Aircraft Dynamics and Automatic Control (1973),
    section 5.7.
    """

    input, output = "de", "q"
    units = {"q": "rad/s"}
    M = gb.Parameter(
        -10.0, bounds=(-1000, 1000), unit="1/s²", about="pitch acceleration per elevator"
    )
    inverse_T_theta2 = gb.Parameter(1.0, bounds=(-20, 20), unit="1/s", about="zero 1/T_θ2")
    zeta_sp = gb.Parameter(0.6, bounds=(-1, 5), unit="1", about="damping ratio of the short period")
    omega_sp = gb.Parameter(
        4.0, bounds=(0.1, 50), unit="rad/s", about="natural frequency of the short period"
    )
    T_delay = gb.Parameter(0.005, bounds=(0, 0.5), unit="s", about="delay of actuator and sensor")

    def response(self, s, p):
        rate = p.M * (s + p.inverse_T_theta2) / _mode(s, p.zeta_sp, p.omega_sp)
        return rate * gb.exp(-s * p.T_delay)


class ShortPeriodAngle(ShortPeriod):
    r"""Pitch angle from the elevator: the integral of the short period.

    $$\frac{\theta}{\delta_e} = \frac{1}{s} \frac{q}{\delta_e}$$

    Source: McRuer, Ashkenas and Graham, Aircraft Dynamics and Automatic Control (1973),
    section 5.7.
    """

    output = "theta"
    units = {"theta": "rad"}

    def response(self, s, p):
        return super().response(s, p) / s


class ShortPeriodAlpha(gb.TransferFunction):
    r"""Angle of attack from the elevator: short period.

    $$\frac{\alpha}{\delta_e} = \frac{M (1 + T_\alpha s)}
    {s^2 + 2 \zeta_{sp} \omega_{sp} s + \omega_{sp}^2} e^{-s T_{delay}}$$

    The zero is that of the lift of the elevator, $T_\alpha = Z_\delta / M$.

    Source: McRuer, Ashkenas and Graham, Aircraft Dynamics and Automatic Control (1973),
    section 5.7.
    """

    input, output = "de", "alpha"
    units = {"alpha": "rad"}
    M = ShortPeriod.M
    T_alpha = gb.Parameter(0.0, bounds=(-1, 1), unit="s", about="lead by the elevator's lift")
    zeta_sp = ShortPeriod.zeta_sp
    omega_sp = ShortPeriod.omega_sp
    T_delay = ShortPeriod.T_delay

    def response(self, s, p):
        angle = p.M * (1 + p.T_alpha * s) / _mode(s, p.zeta_sp, p.omega_sp)
        return angle * gb.exp(-s * p.T_delay)


class Phugoid(gb.TransferFunction):
    r"""Pitch angle from the elevator at low frequencies: phugoid.

    $$\frac{\theta}{\delta_e} = \frac{M (s + 1/T_{\theta 1})}
    {s^2 + 2 \zeta_p \omega_p s + \omega_p^2} e^{-s T_{delay}}$$

    Source: McRuer, Ashkenas and Graham, Aircraft Dynamics and Automatic Control (1973),
    section 5.8.
    """

    input, output = "de", "theta"
    units = {"theta": "rad"}
    M = gb.Parameter(-2.0, bounds=(-1000, 1000), unit="1/s", about="pitch rate per elevator")
    inverse_T_theta1 = gb.Parameter(0.1, bounds=(-5, 5), unit="1/s", about="zero 1/T_θ1")
    zeta_p = gb.Parameter(0.1, bounds=(-1, 5), unit="1", about="damping ratio of the phugoid")
    omega_p = gb.Parameter(
        0.3, bounds=(0.01, 5), unit="rad/s", about="natural frequency of the phugoid"
    )
    T_delay = ShortPeriod.T_delay

    def response(self, s, p):
        angle = p.M * (s + p.inverse_T_theta1) / _mode(s, p.zeta_p, p.omega_p)
        return angle * gb.exp(-s * p.T_delay)


class PitchWithPhugoid(ShortPeriod):
    r"""Pitch angle from the elevator: short period and phugoid.

    $$\frac{\theta}{\delta_e} = \frac{M (s + 1/T_{\theta 1}) (s + 1/T_{\theta 2})}
    {(s^2 + 2 \zeta_p \omega_p s + \omega_p^2)(s^2 + 2 \zeta_{sp} \omega_{sp} s + \omega_{sp}^2)}
    e^{-s T_{delay}}$$

    Source: McRuer, Ashkenas and Graham, Aircraft Dynamics and Automatic Control (1973),
    section 5.6.
    """

    output = "theta"
    units = {"theta": "rad"}
    inverse_T_theta1 = Phugoid.inverse_T_theta1
    zeta_p = Phugoid.zeta_p
    omega_p = Phugoid.omega_p

    def response(self, s, p):
        return super().response(s, p) * (s + p.inverse_T_theta1) / _mode(s, p.zeta_p, p.omega_p)


class ShortPeriodWithPhugoid(PitchWithPhugoid):
    r"""Pitch rate from the elevator: short period and phugoid.

    $$\frac{q}{\delta_e} = s \frac{\theta}{\delta_e}$$

    Source: McRuer, Ashkenas and Graham, Aircraft Dynamics and Automatic Control (1973),
    section 5.6.
    """

    output = "q"
    units = {"q": "rad/s"}

    def response(self, s, p):
        return super().response(s, p) * s


class RollMode(gb.TransferFunction):
    r"""Roll rate from the ailerons: roll mode.

    $$\frac{p}{\delta_a} = \frac{L}{s + 1/T_r} e^{-s T_{delay}}$$

    Source: McRuer, Ashkenas and Graham, Aircraft Dynamics and Automatic Control (1973),
    section 6.7.
    """

    input, output = "da", "p"
    units = {"p": "rad/s"}
    L = gb.Parameter(20.0, bounds=(-1000, 1000), unit="1/s²", about="roll acceleration per aileron")
    inverse_T_r = gb.Parameter(
        3.0, bounds=(0, 100), unit="1/s", about="pole 1/T_r of the roll mode"
    )
    T_delay = ShortPeriod.T_delay

    def response(self, s, p):
        return p.L / (s + p.inverse_T_r) * gb.exp(-s * p.T_delay)


class RollModeAngle(RollMode):
    r"""Bank angle from the ailerons: the integral of the roll mode.

    $$\frac{\phi}{\delta_a} = \frac{1}{s} \frac{p}{\delta_a}$$

    Source: McRuer, Ashkenas and Graham, Aircraft Dynamics and Automatic Control (1973),
    section 6.7.
    """

    output = "phi"
    units = {"phi": "rad"}

    def response(self, s, p):
        return super().response(s, p) / s


class RollWithDutchRoll(RollMode):
    r"""Roll rate from the ailerons: roll mode and dutch roll.

    $$\frac{p}{\delta_a} = \frac{L (s^2 + 2 \zeta_\phi \omega_\phi s + \omega_\phi^2)}
    {(s + 1/T_r)(s^2 + 2 \zeta_d \omega_d s + \omega_d^2)} e^{-s T_{delay}}$$

    Source: McRuer, Ashkenas and Graham, Aircraft Dynamics and Automatic Control (1973),
    section 6.6.
    """

    zeta_phi = gb.Parameter(0.2, bounds=(-1, 5), unit="1", about="damping ratio of the zeros")
    omega_phi = gb.Parameter(
        2.0, bounds=(0.1, 50), unit="rad/s", about="natural frequency of the zeros"
    )
    zeta_d = gb.Parameter(0.2, bounds=(-1, 5), unit="1", about="damping ratio of the dutch roll")
    omega_d = gb.Parameter(
        2.5, bounds=(0.1, 50), unit="rad/s", about="natural frequency of the dutch roll"
    )

    def response(self, s, p):
        coupling = _mode(s, p.zeta_phi, p.omega_phi) / _mode(s, p.zeta_d, p.omega_d)
        return super().response(s, p) * coupling


class RollAngleWithDutchRoll(RollWithDutchRoll):
    r"""Bank angle from the ailerons: roll mode and dutch roll.

    $$\frac{\phi}{\delta_a} = \frac{1}{s} \frac{p}{\delta_a}$$

    Source: McRuer, Ashkenas and Graham, Aircraft Dynamics and Automatic Control (1973),
    section 6.6.
    """

    output = "phi"
    units = {"phi": "rad"}

    def response(self, s, p):
        return super().response(s, p) / s


class DutchRoll(gb.TransferFunction):
    r"""Yaw rate from the rudder: dutch roll.

    $$\frac{r}{\delta_r} = \frac{N (s + z)}
    {s^2 + 2 \zeta_d \omega_d s + \omega_d^2} e^{-s T_{delay}}$$

    Source: McRuer, Ashkenas and Graham, Aircraft Dynamics and Automatic Control (1973),
    section 6.7.
    """

    input, output = "dr", "r"
    units = {"r": "rad/s"}
    N = gb.Parameter(-5.0, bounds=(-1000, 1000), unit="1/s²", about="yaw acceleration per rudder")
    z = gb.Parameter(0.5, bounds=(-20, 20), unit="1/s", about="zero of the yaw rate")
    zeta_d = RollWithDutchRoll.zeta_d
    omega_d = RollWithDutchRoll.omega_d
    T_delay = ShortPeriod.T_delay

    def response(self, s, p):
        rate = p.N * (s + p.z) / _mode(s, p.zeta_d, p.omega_d)
        return rate * gb.exp(-s * p.T_delay)
