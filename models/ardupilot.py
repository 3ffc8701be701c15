"""The angle and rate controllers of ArduPilot: Copter and Plane."""

from math import degrees, radians

import greybox as gb
from greybox.models.digital_filters import biquad, notch, smoothing

COPTER = {"roll": "RLL", "pitch": "PIT", "yaw": "YAW"}  # in names of parameters
PLANE = {"roll": ("RLL", "RLL2SRV"), "pitch": ("PTCH", "PTCH2SRV")}
NOT_MODELED = {
    "SMAX": "the slew limiter lowers P and D in oscillations",
    "PDMX": "it limits P and D together",
    "NTF": "a notch of the setpoint",
}
GAINS = ("P", "I", "D", "FF", "D_FF", "IMAX", "FLTT", "FLTE", "FLTD")
# rad/s², least and greatest: AC_ATTITUDE_ACCEL_RP_CONTROLLER_MIN and MAX, and those of yaw
ACCELERATIONS = {True: (radians(10), radians(120)), False: (radians(40), radians(720))}


class AngleController(gb.Controller):
    r"""Angle error to rate setpoint, by Copter's square-root controller.

    $$q^* = \begin{cases} P e & |e| \le e_l \\ \mathrm{sign}(e) \sqrt{2 a (|e| - e_l/2)} & |e| >
    e_l \end{cases}, \qquad e = \theta^* - \theta, \quad e_l = a / P^2$$

    Linearized, it is its gain P. The rate controller uses the setpoint `delay` samples later: it
    runs before the angle controller in each pass of the loop. Not modeled: input shaping and
    feed-forward (ATC_RATE_FF_ENAB), which act on the setpoint only.

    Source: ArduPilot Copter 4.6, AC_AttitudeControl.cpp (update_ang_vel_target_from_att_error),
    AP_Math/control.cpp (sqrt_controller). Parameters ATC_ANG_PIT_P, ATC_ACCEL_P_MAX.
    """

    states = ("past_1", "past_2", "past_3")
    inputs, outputs = ("theta",), ("q_reference",)
    units = {"reference": "rad", "theta": "rad", "q_reference": "rad/s"}
    P = gb.Parameter(4.5, bounds=(0, 20), unit="1/s", about="ATC_ANG_PIT_P")
    acceleration = gb.Parameter(
        9.6, bounds=(0, 20), unit="rad/s²", about="a, half of ATC_ACCEL_P_MAX; 0: linear"
    )
    delay = gb.Parameter(1.0, bounds=(0, 3), unit="1", about="samples until the setpoint acts")

    def update(self, x, u, p):
        error = u.reference - u.theta
        linear = p.P * error
        end = p.acceleration / gb.maximum(p.P, 1e-6) ** 2
        root = gb.sqrt(gb.maximum(2 * p.acceleration * (abs(error) - end / 2), 1e-12))
        curved = gb.where(error > 0, root, -root)
        beyond = (p.acceleration > 0) * (abs(error) > end)
        rate = gb.where(beyond, curved, linear)
        samples = (rate, x.past_1, x.past_2, x.past_3)
        late = sum(gb.maximum(0, 1 - abs(p.delay - k)) * v for k, v in enumerate(samples))
        return samples[:3], (late,)


class RateController(gb.Controller):
    r"""Rate error to control by AC_PID, once every $h$ seconds.

    $$r_k = r_{k-1} + \alpha_T (q^*_k - r_{k-1}), \qquad e_k = e_{k-1} + \alpha_E (F_n(r_k - q_k) -
    e_{k-1})$$

    $$d_k = d_{k-1} + \alpha_D \left( \frac{e_k - e_{k-1}}{h} - d_{k-1} \right), \qquad i_k =
    \mathrm{sat}(i_{k-1} + I h e_k, IMAX)$$

    $$u_k = P e_k + i_k + D d_k + FF\, r_k + D_{FF} \frac{r_k - r_{k-1}}{h} + u^+_k, \qquad \alpha =
    \frac{2 \pi f h}{1 + 2 \pi f h}$$

    The cutoffs f are FLTT, FLTE and FLTD; zero means no filter. $F_n$ is the notch of the error
    (NEF). After a sample at the limit of ±1 the integral may only shrink. $u^+$ (`mixer`) is where
    System Identification mode injects its mixer axes. The measured rate has passed the filters of
    the gyro. Not modeled: the slew limiter SMAX, PDMX, the notch of the target NTF.

    Source: ArduPilot 4.6, AC_PID.cpp (update_all, update_i) and AC_AttitudeControl_Multi.cpp
    (rate_controller_run); NotchFilter.cpp. Parameters ATC_RAT_PIT_*.
    """

    states = ("target", "error", "derivative", "integral", "notch_1", "notch_2", "limited")
    inputs, setpoints, outputs = ("q",), ("q_reference", "mixer"), ("u",)
    units = {"q_reference": "rad/s", "q": "rad/s"}
    P = gb.Parameter(0.135, bounds=(0, 5), unit="s", about="per rate error")
    I = gb.Parameter(0.135, bounds=(0, 5), unit="1", about="per integral of the rate error")  # noqa: E741
    D = gb.Parameter(0.0036, bounds=(0, 1), unit="s²", about="per derivative of the rate error")
    FF = gb.Parameter(0.0, bounds=(0, 5), unit="s", about="per rate setpoint")
    D_FF = gb.Parameter(0.0, bounds=(0, 1), unit="s²", about="per derivative of the setpoint")
    IMAX = gb.Parameter(0.5, bounds=(0, 1), unit="1", about="limit of the integral")
    FLTT = gb.Parameter(20.0, bounds=(0, 200), unit="Hz", about="filter of the setpoint")
    FLTE = gb.Parameter(0.0, bounds=(0, 200), unit="Hz", about="filter of the error")
    FLTD = gb.Parameter(20.0, bounds=(0, 200), unit="Hz", about="filter of the derivative")
    notch = gb.Parameter(0.0, bounds=(0, 200), unit="Hz", about="center of the notch; 0: none")
    notch_Q = gb.Parameter(2.0, bounds=(0.1, 100), unit="1", about="center over bandwidth")
    notch_depth = gb.Parameter(40.0, bounds=(0, 100), unit="dB", about="attenuation")
    u_max = gb.Parameter(1.0, bounds=(0.01, 10), unit="1", about="limit of the control")

    def update(self, x, u, p):
        following, terms, forward = self.terms(x, u.q_reference, u.q, p)
        return self.limited(following, terms + forward + u.mixer, p)

    def terms(self, x, setpoint, q, p):
        """Return the next states, the sum of P, I and D, and the feed-forward."""
        h = 1 / self.rate
        target = x.target + smoothing(p.FLTT, self.rate) * (setpoint - x.target)
        notched, raw = self._notched(x, target - q, p)
        error = x.error + smoothing(p.FLTE, self.rate) * (raw - x.error)
        derivative = x.derivative + smoothing(p.FLTD, self.rate) * (
            (error - x.error) / h - x.derivative
        )
        grown = gb.maximum(-p.IMAX, gb.minimum(p.IMAX, x.integral + p.I * h * error))
        integrates = gb.maximum(1 - x.limited, x.integral * error < 0)
        integral = gb.where(integrates, grown, x.integral)
        forward = p.FF * target + p.D_FF * (target - x.target) / h
        total = p.P * error + integral + p.D * derivative
        return (target, error, derivative, integral, *notched), total, forward

    def limited(self, following, demand, p):
        """Return the states and the control within its limits."""
        at_limit = gb.where(abs(demand) >= p.u_max, 1, 0)
        control = gb.maximum(-p.u_max, gb.minimum(p.u_max, demand))
        return (*following, at_limit), (control,)

    def _notched(self, x, sample, p):
        # Without a notch its states must not grow: any center inside the unit circle will do.
        center = gb.where(p.notch > 0, p.notch, self.rate / 8)
        b, a = notch(center, p.notch_Q, p.notch_depth, self.rate)
        state, output = biquad((x.notch_1, x.notch_2), sample, b, a)
        return state, gb.where(p.notch > 0, output, sample)


class PlaneAngleController(gb.Controller):
    r"""Angle error to rate setpoint of Plane, $q^* = e / \tau$.

    Source: ArduPilot Plane 4.5, AP_PitchController.cpp and AP_RollController.cpp (get_servo_out).
    Parameters PTCH2SRV_TCONST, RLL2SRV_TCONST. Not modeled: rate limits and turn coordination.
    """

    inputs, outputs, rate = ("theta",), ("q_reference",), 50.0
    units = {"reference": "rad", "theta": "rad", "q_reference": "rad/s"}
    tau = gb.Parameter(0.5, bounds=(0.05, 5), unit="s", about="PTCH2SRV_TCONST")

    def update(self, x, u, p):
        return (), ((u.reference - u.theta) / p.tau,)


class PlaneRateController(RateController):
    r"""Rate error to surface by AC_PID, with the airspeed scaling of Plane.

    Setpoint and rate are multiplied by $s^2$, the square of the speed scaler, and FF acts with $s$:
    with $PID$ the law of `RateController` without FF,

    $$u_k = \frac{180}{45 \pi} \left( PID(s^2 q^*_k, s^2 q_k) + FF\, \frac{r_k}{s\, n} \right),
    \qquad s = \frac{SCALING\_SPEED}{V}$$

    where $r$ is the filtered scaled setpoint and $n$ the ratio of true to equivalent airspeed. The
    gains are those of one airspeed: a margin holds at that speed.

    Source: ArduPilot Plane 4.5, AP_FW_Controller.cpp and AP_PitchController.cpp (_get_rate_out).
    Parameters PTCH_RATE_* and RLL_RATE_*; the scaler is logged as AETR.SS.
    """

    rate = 50.0
    scaler = gb.Parameter(1.0, bounds=(0.1, 10), unit="1", about="s, AETR.SS")
    density = gb.Parameter(1.0, bounds=(0.5, 3), unit="1", about="n, true over equivalent airspeed")

    def update(self, x, u, p):
        square = p.scaler**2
        following, terms, forward = self.terms(x, square * u.q_reference, square * u.q, p)
        demand = degrees(1) / 45 * (terms + forward / (p.scaler * p.density)) + u.mixer
        return self.limited(following, demand, p)


def copter(parameters, axis, rate):
    """Return the angle and the rate controller of an axis with these parameters, and notes."""
    name = COPTER[axis]
    low, high = ACCELERATIONS[axis == "yaw"]
    half = radians(parameters.get(f"ATC_ACCEL_{name[0]}_MAX", 0) / 100) / 2
    angle = {"P": parameters[f"ATC_ANG_{name}_P"]}
    angle["acceleration"] = min(max(half, low), high) if half > 0 else 0.0
    gains, notes = _pid(parameters, f"ATC_RAT_{name}_")
    if parameters.get("ATC_RATE_FF_ENAB", 0) > 0:
        notes.append("ATC_RATE_FF_ENAB feeds the setpoint forward, which is not modeled.")
    if parameters.get("FSTRATE_ENABLE", 0) > 0:
        notes.append(
            "FSTRATE_ENABLE runs the rate controller faster than SCHED_LOOP_RATE, which is not "
            "modeled: it has less delay than here."
        )
    return [AngleController(angle, rate=rate), RateController(gains, rate=rate)], notes


def plane(parameters, axis, rate, scaler=1.0):
    """Return the same for Plane, with its speed scaler."""
    if axis not in PLANE:
        raise ValueError(f"the controller of {axis} is not modeled for a plane: roll or pitch is.")
    name, servo = PLANE[axis]
    gains, notes = _pid(parameters, f"{name}_RATE_")
    angle = {"tau": parameters[f"{servo}_TCONST"]}
    notes.append(f"The gains are those at a speed scaler of {scaler:.3g}.")
    controllers = [
        PlaneAngleController(angle, rate=rate),
        PlaneRateController({**gains, "scaler": scaler}, rate=rate),
    ]
    return controllers, notes


def _pid(parameters, begin):
    gains = {n: parameters[begin + n] for n in GAINS if begin + n in parameters or n in "PID"}
    notes = [
        f"{begin}{n} = {parameters[begin + n]:g} is not modeled: {what}."
        for n, what in NOT_MODELED.items()
        if parameters.get(begin + n, 0) > 0
    ]
    notes += [
        f"{begin}{n} is not in the log: {RateController.parameters[n].start:g} Hz is assumed."
        for n in ("FLTT", "FLTE", "FLTD")
        if n not in gains
    ]
    filter_ = f"FILT{int(parameters.get(begin + 'NEF', 0))}_"
    if parameters.get(filter_ + "TYPE", 0) == 1:
        ends = {"notch": "NOTCH_FREQ", "notch_Q": "NOTCH_Q", "notch_depth": "NOTCH_ATT"}
        gains |= {n: parameters[filter_ + end] for n, end in ends.items()}
    return gains, notes
