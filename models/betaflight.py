"""The rate controller of Betaflight."""

from math import degrees, inf

import greybox as gb
from greybox.models.digital_filters import biquad, butterworth, notch, smoothing

# Scales of P, I and D in the configurator, in pidSum per deg/s: flight/pid.h.
SCALES = {"P": 0.032029, "I": 0.244381, "D": 0.000529}
MIXER = 1000  # pidSum of a control of 1: PID_MIXER_SCALING
PT1, BIQUAD, PT2, PT3 = range(4)
# PT2 and PT3 are PT1 filters in series, which together have the cutoff: common/filter.c.
SERIES = {PT1: (1, 1.0), PT2: (2, 1.553773974), PT3: (3, 1.961459177)}
# Blackbox Explorer writes settings by names of older firmware: src/flightlog_parser.js.
NAMES = {
    "dterm_lpf_hz": "dterm_lpf1_static_hz",
    "dterm_lpf_dyn_hz[0]": "dterm_lpf1_dyn_hz[0]",
    "dterm_lpf2_hz": "dterm_lpf2_static_hz",
    "dterm_filter_type": "dterm_lpf1_type",
    "dterm_filter2_type": "dterm_lpf2_type",
    "gyro_lowpass_hz": "gyro_lpf1_static_hz",
    "gyro_lowpass_dyn_hz[0]": "gyro_lpf1_dyn_hz[0]",
    "gyro_lowpass2_hz": "gyro_lpf2_static_hz",
    "gyro_soft_type": "gyro_lpf1_type",
    "gyro_soft2_type": "gyro_lpf2_type",
    "gyro_rpm_notch_harmonics": "rpm_filter_harmonics",
    "pidSumLimit": "pidsum_limit",
    "pidSumLimitYaw": "pidsum_limit_yaw",
    "yaw_lpf_hz": "yaw_lowpass_hz",
}


class RateController(gb.Controller):
    r"""Rate error to pidSum/1000 by Betaflight's PID, once every $h$ seconds.

    $$e_k = q^*_k - q_k, \qquad i_k = \mathrm{sat}(i_{k-1} + I\, s_I h e_k, i_{max}), \qquad f_k =
    F_2 F_1 F_n q_k$$

    $$u_k = \frac{1}{1000} \mathrm{sat}\left( T_P P\, s_P e_k + i_k - T D\, s_D \frac{f_k -
    f_{k-1}}{h}, 500 \right)$$

    in deg/s, with P, I and D as the configurator shows them, and $s_P = 0.032029$, $s_I =
    0.244381$ (2.5 times as much for yaw), $s_D = 0.000529$. $F_n$ is the notch of the D term. $F_1$
    and $F_2$ are its low-pass filters: PT1 (type 0), biquad (1), PT2 (2) or PT3 (3). $T$ is the
    factor of throttle PID attenuation (TPA), here a constant; it acts on P, as $T_P$, only if
    tpa_mode is PD.
    D is that of quiet flight. Not modeled:
    feed-forward, I-term relax, anti-gravity, dynamic D, the filter of yaw P.

    Source: Betaflight 4.5, flight/pid.c (pidController), pid.h, pid_init.c, common/filter.c.
    """

    states = (
        "integral",
        "before",
        "notch_1",
        "notch_2",
        *(f"f{k}_{n}" for k in (1, 2) for n in (1, 2, 3)),
    )
    inputs, setpoints, outputs, rate = ("q",), ("q_reference", "mixer"), ("u",), 4000.0
    units = {"q_reference": "rad/s", "q": "rad/s"}
    P = gb.Parameter(45.0, bounds=(0, 250), unit="1", about="rollPID, first")
    I = gb.Parameter(80.0, bounds=(0, 250), unit="1", about="rollPID, second")  # noqa: E741
    D = gb.Parameter(30.0, bounds=(0, 250), unit="1", about="rollPID, third; d_min where lower")
    I_factor = gb.Parameter(1.0, bounds=(0, 5), unit="1", about="2.5 for yaw")
    TPA = gb.Parameter(1.0, bounds=(0, 1), unit="1", about="T, at the throttle of the flight")
    TPA_P = gb.Parameter(1.0, bounds=(0, 1), unit="1", about="T_P: T if tpa_mode is PD, else 1")
    i_max = gb.Parameter(400.0, bounds=(0, 500), unit="1", about="iterm_limit")
    u_max = gb.Parameter(500.0, bounds=(100, 1000), unit="1", about="pidsum_limit")
    lpf1_type = gb.Parameter(PT1, bounds=(0, 3), unit="1", about="dterm_lpf1_type")
    lpf1 = gb.Parameter(75.0, bounds=(0, 1000), unit="Hz", about="dterm_lpf1_static_hz; 0: none")
    lpf2_type = gb.Parameter(PT1, bounds=(0, 3), unit="1", about="dterm_lpf2_type")
    lpf2 = gb.Parameter(150.0, bounds=(0, 1000), unit="Hz", about="dterm_lpf2_static_hz; 0: none")
    notch = gb.Parameter(0.0, bounds=(0, 1000), unit="Hz", about="dterm_notch_hz; 0: none")
    notch_Q = gb.Parameter(2.0, bounds=(0.1, 100), unit="1", about="center over bandwidth")

    def update(self, x, u, p):
        error = degrees(1) * (u.q_reference - u.q)
        integral = x.integral + p.I * p.I_factor * SCALES["I"] / self.rate * error
        integral = gb.maximum(-p.i_max, gb.minimum(p.i_max, integral))
        notched, filtered = (x.notch_1, x.notch_2), degrees(1) * u.q
        if p.notch > 0:
            notched, filtered = biquad(
                notched, filtered, *notch(p.notch, p.notch_Q, inf, self.rate)
            )
        first = (x.f1_1, x.f1_2, x.f1_3)
        first, filtered = self._filtered(first, filtered, p.lpf1, int(p.lpf1_type))
        second = (x.f2_1, x.f2_2, x.f2_3)
        second, filtered = self._filtered(second, filtered, p.lpf2, int(p.lpf2_type))
        slope = (filtered - x.before) * self.rate
        total = p.TPA_P * p.P * SCALES["P"] * error - p.TPA * p.D * SCALES["D"] * slope + integral
        total = gb.maximum(-p.u_max, gb.minimum(p.u_max, total))
        return (integral, filtered, *notched, *first, *second), (total / MIXER + u.mixer,)

    def _filtered(self, state, sample, cutoff, kind):
        if cutoff <= 0:
            return state, sample
        if kind == BIQUAD:
            following, output = biquad(state[:2], sample, *butterworth(cutoff, self.rate))
            return (*following, state[2]), output
        count, correction = SERIES[kind]
        share = smoothing(cutoff * correction, self.rate)
        following = list(state)
        for k in range(count):
            sample = following[k] = state[k] + share * (sample - state[k])
        return tuple(following), sample


def translated(parameters):
    """Return settings by the names of Betaflight 4.5."""
    return {NAMES.get(name, name): value for name, value in parameters.items()}


def controllers(parameters, axis):
    """Return the rate controller of an axis with the settings of a blackbox header, and notes."""
    k = ("roll", "pitch", "yaw").index(axis)
    gains = {n: parameters[f"{axis}PID[{j}]"] for j, n in enumerate("PID")}
    # Explorer appends d_min to the gains. Firmware since 2025 states d_max, and D is the least.
    quiet = parameters.get(f"d_min[{k}]", parameters.get(f"{axis}PID[3]", 0))
    if 0 < quiet < gains["D"]:
        gains["D"] = quiet
    gains["I_factor"] = 2.5 if axis == "yaw" and not parameters.get("use_integrated_yaw") else 1.0
    for n in (1, 2):
        gains[f"lpf{n}"] = parameters.get(f"dterm_lpf{n}_static_hz", 0)
        gains[f"lpf{n}_type"] = parameters.get(f"dterm_lpf{n}_type", PT1)
    gains["i_max"] = parameters.get("iterm_limit", 400)
    limit = parameters.get("pidsum_limit_yaw" if axis == "yaw" else "pidsum_limit", 500)
    gains["u_max"] = max(limit, 100)
    center, end = (parameters.get(f"dterm_notch_{n}", 0) for n in ("hz", "cutoff"))
    if center > end > 0:  # filterGetNotchQ
        gains |= {"notch": center, "notch_Q": center * end / (center**2 - end**2)}
    rate = 1e6 / (parameters["looptime"] * parameters.get("pid_process_denom", 1))

    notes = []
    low = parameters.get("dterm_lpf1_dyn_hz[0]", 0)
    if low > 0:
        gains["lpf1"] = low
        notes.append(f"The first filter of the D term is that of low throttle, {low:g} Hz.")
    if gains["D"] > 0 and gains["lpf1"] == gains["lpf2"] == 0:
        notes.append("The settings name no filter of the D term, so none is modeled.")
    for name in ("tpa_rate", "yaw_lowpass_hz" if axis == "yaw" else ""):
        if parameters.get(name, 0) > 0:
            notes.append(f"{name} = {parameters[name]:g} is not modeled.")
    return [RateController(gains, rate=rate)], notes
