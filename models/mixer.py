"""From the controls of the axes to the motors, and from the rotor speeds to the torques, (2.3)."""

from types import SimpleNamespace

import greybox as gb


class Mixer(gb.StateSpace):
    r"""Motor controls from the thrust, roll, pitch and yaw controls, below (2.3).

    $$\begin{aligned} u_1 &= u_F - 0.5 u_\phi - 0.5 u_\theta + u_\psi, & u_2 &= u_F + 0.5 u_\phi +
    0.5 u_\theta + u_\psi, \\ u_3 &= u_F + 0.5 u_\phi - 0.5 u_\theta - u_\psi, & u_4 &= u_F - 0.5
    u_\phi + 0.5 u_\theta - u_\psi \end{aligned}$$

    A static model of the symmetric X frame. `LimitedMixer` has the limits of the controls.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, below (2.3).
    """

    inputs = ("u_F", "u_phi", "u_theta", "u_psi")
    outputs = ("u_1", "u_2", "u_3", "u_4")

    def output(self, x, u, p):
        return (
            u.u_F - 0.5 * u.u_phi - 0.5 * u.u_theta + u.u_psi,
            u.u_F + 0.5 * u.u_phi + 0.5 * u.u_theta + u.u_psi,
            u.u_F + 0.5 * u.u_phi - 0.5 * u.u_theta - u.u_psi,
            u.u_F - 0.5 * u.u_phi + 0.5 * u.u_theta - u.u_psi,
        )


class LimitedMixer(Mixer):
    r"""Motor controls within their limits, below (2.3).

    $$u_k = \mathrm{sat}(m_k(u_F, \mathrm{sat}(u_\phi, \pm 0.5), \mathrm{sat}(u_\theta, \pm 0.5),
    \mathrm{sat}(u_\psi, \pm 0.5)), 0, 1)$$

    $m_k$ are the sums of `Mixer`. Within the limits both are the same. Beyond them, each motor is
    limited by itself, so that one axis disturbs the others. A flight controller gives priority to
    some of them, which the paper does not describe.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, below (2.3).
    """

    def output(self, x, u, p):
        axes = {name: _limited(getattr(u, name), -0.5, 0.5) for name in self.inputs[1:]}
        motors = super().output(x, SimpleNamespace(u_F=u.u_F, **axes), p)
        return tuple(_limited(motor, 0, 1) for motor in motors)


def _limited(value, low, high):
    return gb.maximum(low, gb.minimum(value, high))


class Torques(gb.StateSpace):
    r"""Torques about the body axes from the four rotor speeds, (2.3).

    $$\begin{aligned} \tau_\phi &= K_\tau (\Omega_2^2 + \Omega_3^2 - \Omega_1^2 - \Omega_4^2), \\
    \tau_\theta &= K_\tau (\Omega_2^2 + \Omega_4^2 - \Omega_1^2 - \Omega_3^2), \\
    \tau_\psi &= K_\psi (\Omega_1^2 + \Omega_2^2 - \Omega_3^2 - \Omega_4^2) \end{aligned}$$

    A static model of the symmetric X frame.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.3).
    """

    inputs = ("Omega_1", "Omega_2", "Omega_3", "Omega_4")
    outputs = ("tau_phi", "tau_theta", "tau_psi")
    K_tau = gb.Parameter(
        2e-6,
        bounds=(1e-9, 1e-3),
        unit="N·m·s²",
        about="roll and pitch torque per squared speed",
        scale="log",
    )
    K_psi = gb.Parameter(
        2e-7, bounds=(1e-10, 1e-4), unit="N·m·s²", about="yaw torque per squared speed", scale="log"
    )

    def output(self, x, u, p):
        one, two, three, four = (speed**2 for speed in (u.Omega_1, u.Omega_2, u.Omega_3, u.Omega_4))
        return (
            p.K_tau * (two + three - one - four),
            p.K_tau * (two + four - one - three),
            p.K_psi * (one + two - three - four),
        )
