"""Pitch with more terms of the moment than (4.23): products of velocity, angle and rate."""

import math

import greybox as gb
from greybox.models.tilt import PAPER_G, NonlinearTilt, TiltParameters


class MomentParameters(TiltParameters):
    """The coefficients of the candidate terms, each of them absent at zero."""

    b_vv = gb.Parameter(
        0.0, bounds=(-20, 20), unit="1/m²", about="moment by the square of the velocity", fixed=True
    )
    b_vtheta = gb.Parameter(
        0.0, bounds=(-500, 500), unit="1/(m·s)", about="stiffness per velocity", fixed=True
    )
    b_vq = gb.Parameter(0.0, bounds=(-20, 20), unit="1/m", about="damping per velocity", fixed=True)
    b_thetatheta = gb.Parameter(
        0.0, bounds=(-20000, 20000), unit="1/s²", about="stiffness per angle", fixed=True
    )
    b_thetaq = gb.Parameter(
        0.0, bounds=(-500, 500), unit="1/s", about="damping per angle", fixed=True
    )
    b_vtau = gb.Parameter(
        0.0, bounds=(-200, 200), unit="1/(m·s)", about="loss of control per velocity", fixed=True
    )


MOMENT_TERMS = ("b_vv", "b_vtheta", "b_vq", "b_thetatheta", "b_thetaq", "b_vtau")


class TiltMoment(MomentParameters, NonlinearTilt):
    r"""Tilt angle and velocity, (4.23) with more terms of the moment, which vanish in hover.

    $$\dot q = -a_1 \theta - a_2 q - a_3 v + a_4 \tau_\theta
    - b_{vv} |v| v - b_{v\theta} |v| \theta - b_{vq} |v| q - b_{\theta\theta} |\theta| \theta
    - b_{\theta q} |\theta| q - b_{v\tau} |v| \tau_\theta$$

    All additions are odd, as those of a symmetric vehicle are: a flight backward is the mirror
    image of one forward. With all of them at zero it is `NonlinearTilt`.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (4.21) and (4.23).
    """

    def derivative(self, x, u, p):
        dv, dq, dtheta, drotor = super().derivative(x, u, p)
        speed, angle = abs(x.v), abs(x.theta)
        more = (
            p.b_vv * speed * x.v
            + p.b_vtheta * speed * x.theta
            + p.b_vq * speed * x.q
            + p.b_thetatheta * angle * x.theta
            + p.b_thetaq * angle * x.q
            + p.b_vtau * speed * x.rotor
        )
        return dv, dq - more, dtheta, drotor


class TiltMomentAt(MomentParameters, gb.TransferFunction):
    r"""Tilt angle from the tilt control about an angle of flight, (4.25) with linearized terms.

    $a_1$ to $a_4$ are

    $$A_1 = a_1 + b_{v\theta} v_0 + 2 b_{\theta\theta} \theta_0, \quad A_2 = a_2 + b_{vq} v_0 +
    b_{\theta q} \theta_0, \quad A_3 = a_3 + 2 b_{vv} v_0 + b_{v\theta} \theta_0 + b_{v\tau} \tau_0,
    \quad A_4 = a_4 - b_{v\tau} v_0$$

    there, with $2 C_x v_0$ for $a_5$ and $g / \cos^2\theta_0$ for $g$, where $C_x v_0^2 = g
    \tan\theta_0$ and the moment is zero at $\tau_0$.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (4.21), (4.23) and
    (4.25).

    Parameters
    ----------
    angle : float
        The angle of flight, rad, from zero on.
    drag : float
        C_x, 1/m.
    """

    input, output = "u", "theta"
    units = {"theta": "rad"}

    def __init__(self, angle=0.0, drag=0.01):
        if not 0 <= angle < math.pi / 2 or not drag > 0:
            raise ValueError(
                f"angle = {angle} and drag = {drag}: give an angle from 0 to below π/2 and a drag "
                f"above 0."
            )
        self.angle = angle
        self.drag = drag

    @property
    def label(self):
        return f"TiltMoment at {math.degrees(self.angle):.3g}°"

    def response(self, s, p):
        angle = self.angle
        speed = math.sqrt(PAPER_G * math.tan(angle) / self.drag)
        a5 = 2 * self.drag * speed
        moment = p.a1 * angle + p.a3 * speed + p.b_vv * speed**2 + p.b_vtheta * speed * angle
        a4 = p.a4 - p.b_vtau * speed
        torque = (moment + p.b_thetatheta * angle**2) / a4
        a1 = p.a1 + p.b_vtheta * speed + 2 * p.b_thetatheta * angle
        a2 = p.a2 + p.b_vq * speed + p.b_thetaq * angle
        a3 = p.a3 + 2 * p.b_vv * speed + p.b_vtheta * angle + p.b_vtau * torque
        coupling = PAPER_G / math.cos(angle) ** 2 * a3
        tilt = (s + a5) / ((s + a5) * (s**2 + a2 * s + a1) + coupling)
        return a4 * tilt / (p.T_rotor * s + 1) * gb.exp(-s * p.T_delay)
