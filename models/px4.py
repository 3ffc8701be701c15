"""The angle and rate controllers of PX4's multicopters."""

from math import pi, radians

import greybox as gb
from greybox.models.digital_filters import smoothing

LIMITS = {"roll": "RR", "pitch": "PR", "yaw": "YR"}  # in the names of limits of integrals
FULL = 400 * pi / 180  # rad/s, error at which the integral stops


class AngleController(gb.Controller):
    r"""Angle error to rate setpoint, $q^* = \mathrm{sat}(P (\theta^* - \theta), q_{max})$.

    The error is that of the quaternion, $2 \sin(e/2)$, which is the angle for small ones. For yaw,
    the weight MC_YAW_WEIGHT cancels in this gain.

    Source: PX4 1.15, mc_att_control/AttitudeControl/AttitudeControl.cpp (update). Parameters
    MC_PITCH_P, MC_PITCHRATE_MAX. Not modeled: feed-forward of the yaw rate.
    """

    inputs, outputs = ("theta",), ("q_reference",)
    units = {"reference": "rad", "theta": "rad", "q_reference": "rad/s"}
    P = gb.Parameter(6.5, bounds=(0, 20), unit="1/s", about="MC_PITCH_P")
    q_max = gb.Parameter(3.84, bounds=(0.1, 40), unit="rad/s", about="MC_PITCHRATE_MAX")

    def update(self, x, u, p):
        rate = p.P * 2 * gb.sin((u.reference - u.theta) / 2)
        return (), (gb.maximum(-p.q_max, gb.minimum(p.q_max, rate)),)


class RateController(gb.Controller):
    r"""Rate error to normalized torque, once every $h$ seconds.

    $$a_k = a_{k-1} + \alpha \left( \frac{q_k - q_{k-1}}{h} - a_{k-1} \right), \qquad e_k = q^*_k -
    q_k$$

    $$u_k = K P e_k + i_k - K D a_k + FF\, q^*_k, \qquad i_{k+1} = \mathrm{sat}(i_k + \eta_k K I h
    e_k, i_{max}), \quad \eta_k = \max(0, 1 - (e_k / 400°)^2)$$

    $\alpha$ is the smoothing of the cutoff IMU_DGYRO_CUTOFF. The torque of yaw passes another
    first-order low-pass filter, MC_YAW_TQ_CUTOFF. The measured rate has passed the filters of the
    gyro, IMU_GYRO_CUTOFF, at the gyro's own rate. The test signal of a chirp or autotune module is
    added to the control (`mixer`). Not modeled: the stop of the integral by the control allocation,
    and the scaling by the battery voltage.

    Source: PX4 1.15, lib/rate_control/rate_control.cpp (update, updateIntegral),
    mc_rate_control/MulticopterRateControl.cpp, VehicleAngularVelocity.cpp, AlphaFilter.hpp.
    Parameters MC_PITCHRATE_*.
    """

    states = ("q_before", "acceleration", "integral", "torque")
    inputs, setpoints, outputs = ("q",), ("q_reference", "mixer"), ("u",)
    units = {"q_reference": "rad/s", "q": "rad/s"}
    K = gb.Parameter(1.0, bounds=(0, 10), unit="1", about="factor of P, I and D")
    P = gb.Parameter(0.15, bounds=(0, 5), unit="s", about="per rate error")
    I = gb.Parameter(0.2, bounds=(0, 5), unit="1", about="per integral of the rate error")  # noqa: E741
    D = gb.Parameter(0.003, bounds=(0, 1), unit="s²", about="per angular acceleration")
    FF = gb.Parameter(0.0, bounds=(0, 5), unit="s", about="per rate setpoint")
    i_max = gb.Parameter(0.3, bounds=(0, 1), unit="1", about="limit of the integral, MC_PR_INT_LIM")
    cutoff = gb.Parameter(30.0, bounds=(0, 1000), unit="Hz", about="IMU_DGYRO_CUTOFF")
    torque_cutoff = gb.Parameter(0.0, bounds=(0, 10), unit="Hz", about="MC_YAW_TQ_CUTOFF, of yaw")

    def update(self, x, u, p):
        h = 1 / self.rate
        share = smoothing(p.cutoff, self.rate)
        acceleration = x.acceleration + share * ((u.q - x.q_before) / h - x.acceleration)
        error = u.q_reference - u.q
        demand = p.K * (p.P * error - p.D * acceleration) + x.integral + p.FF * u.q_reference
        torque = x.torque + smoothing(p.torque_cutoff, self.rate) * (demand - x.torque)
        factor = gb.maximum(0, 1 - (error / FULL) ** 2)
        integral = x.integral + factor * p.K * p.I * h * error
        integral = gb.maximum(-p.i_max, gb.minimum(p.i_max, integral))
        return (u.q, acceleration, integral, torque), (torque + u.mixer,)


def controllers(parameters, axis, rate):
    """Return the angle and the rate controller of an axis with these parameters, and notes."""
    begin = f"MC_{axis.upper()}"
    gains = {n: parameters[f"{begin}RATE_{n}"] for n in ("K", "P", "I", "D", "FF")}
    gains["i_max"] = parameters[f"MC_{LIMITS[axis]}_INT_LIM"]
    gains["cutoff"] = parameters.get("IMU_DGYRO_CUTOFF", 0)
    if axis == "yaw":
        gains["torque_cutoff"] = parameters.get("MC_YAW_TQ_CUTOFF", 0)
    angle = {"P": parameters[f"{begin}_P"], "q_max": radians(parameters[f"{begin}RATE_MAX"])}
    notes = []
    if "IMU_DGYRO_CUTOFF" not in parameters:
        notes.append("IMU_DGYRO_CUTOFF is not in the log: no filter of the D term is assumed.")
    if parameters.get("MC_BAT_SCALE_EN", 0) > 0:
        notes.append("MC_BAT_SCALE_EN scales the control with the battery, which is not modeled.")
    return [AngleController(angle, rate=rate), RateController(gains, rate=rate)], notes
