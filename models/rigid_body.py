"""Rotation of a rigid body: Euler angles (2.1) and Newton-Euler rates (2.2)."""

import greybox as gb


class EulerKinematics(gb.StateSpace):
    r"""Euler angles from the body rates, (2.1).

    $$\begin{bmatrix} \dot\phi \\ \dot\theta \\ \dot\psi \end{bmatrix} = \begin{bmatrix}
    1 & \sin\phi \tan\theta & \cos\phi \tan\theta \\ 0 & \cos\phi & -\sin\phi \\
    0 & \sin\phi / \cos\theta & \cos\phi / \cos\theta \end{bmatrix}
    \begin{bmatrix} p \\ q \\ r \end{bmatrix}$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.1).
    """

    states = ("phi", "theta", "psi")
    inputs = ("p", "q", "r")
    outputs = ("phi", "theta", "psi")

    def derivative(self, x, u, p):
        return euler_rates(x, u)

    def output(self, x, u, p):
        return (x.phi, x.theta, x.psi)


class RigidBody(gb.StateSpace):
    r"""Euler angles and body rates from the torques, (2.1) with (2.2).

    $$\begin{bmatrix} \dot p \\ \dot q \\ \dot r \end{bmatrix} = \begin{bmatrix} \frac{J_y -
    J_z}{J_x} q r \\ \frac{J_z - J_x}{J_y} p r \\ \frac{J_x - J_y}{J_z} p q \end{bmatrix} +
    \begin{bmatrix} \tau_\phi / J_x \\ \tau_\theta / J_y \\ \tau_\psi / J_z \end{bmatrix}$$

    The angles follow (2.1), see `EulerKinematics`. The body axes are principal axes. Unless the
    torques are measured, flight data determine only the ratios of the inertias to the torque gains.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.1) and (2.2).
    """

    states = ("phi", "theta", "psi", "p", "q", "r")
    inputs = ("tau_phi", "tau_theta", "tau_psi")
    outputs = states
    J_x = gb.Parameter(
        0.01, bounds=(1e-4, 1), unit="kg·m²", about="inertia about body x", scale="log"
    )
    J_y = gb.Parameter(
        0.01, bounds=(1e-4, 1), unit="kg·m²", about="inertia about body y", scale="log"
    )
    J_z = gb.Parameter(
        0.02, bounds=(1e-4, 1), unit="kg·m²", about="inertia about body z", scale="log"
    )

    def derivative(self, x, u, p):
        return (
            *euler_rates(x, x),
            (p.J_y - p.J_z) / p.J_x * x.q * x.r + u.tau_phi / p.J_x,
            (p.J_z - p.J_x) / p.J_y * x.p * x.r + u.tau_theta / p.J_y,
            (p.J_x - p.J_y) / p.J_z * x.p * x.q + u.tau_psi / p.J_z,
        )

    def output(self, x, u, p):
        return (x.phi, x.theta, x.psi, x.p, x.q, x.r)


def euler_rates(angles, rates):
    """Return the derivatives of phi, theta and psi, (2.1)."""
    sine = gb.sin(angles.phi)
    cosine = gb.cos(angles.phi)
    turn = sine * rates.q + cosine * rates.r  # rad/s, heading rate times cos(theta)
    return (
        rates.p + turn * gb.tan(angles.theta),
        cosine * rates.q - sine * rates.r,
        turn / gb.cos(angles.theta),
    )
