"""Filters of flight controllers, sample by sample, in the path from a sensor to a controller."""

from math import atan, pi, tan

import greybox as gb


def smoothing(cutoff, rate):
    """Return the share of a new sample in a first-order low-pass filter; 1 without a cutoff."""
    x = 2 * pi * cutoff / rate
    return gb.where(x > 0, x / (1 + x), 1.0)


def biquad(state, sample, b, a):
    """Advance a second-order section (direct form II transposed): its states and its output."""
    output = b[0] * sample + state[0]
    return (b[1] * sample - a[0] * output + state[1], b[2] * sample - a[1] * output), output


def butterworth(cutoff, rate):
    """Return b and a of a second-order Butterworth low-pass filter, bilinear and prewarped."""
    omega = gb.tan(pi * cutoff / rate)
    scale = 1 + 2**0.5 * omega + omega**2
    b = omega**2 / scale
    return (b, 2 * b, b), (2 * (omega**2 - 1) / scale, (1 - 2**0.5 * omega + omega**2) / scale)


def notch(center, quality, attenuation, rate):
    """Return b and a of a notch filter: center in Hz, center over bandwidth, dB at the center."""
    omega = 2 * pi * center / rate
    alpha = gb.sin(omega) / (2 * quality)
    square = 10 ** (-attenuation / 20)
    middle = -2 * gb.cos(omega) / (1 + alpha)
    b = ((1 + alpha * square) / (1 + alpha), middle, (1 - alpha * square) / (1 + alpha))
    return b, (middle, (1 - alpha) / (1 + alpha))


def at_loop_rate(frequency, rate, gyro_rate):
    """Return the frequency, Hz, at which a filter at the loop's rate acts as the gyro's does.

    Both come from the same filter in continuous time: their phases agree at low frequencies, where
    a loop crosses over, even if the filter's frequency is above half of the loop's rate.
    """
    if gyro_rate <= 0:
        return frequency
    return rate / pi * atan(gyro_rate / rate * tan(pi * frequency / gyro_rate))


class SampledLowPass(gb.Controller):
    r"""Second-order Butterworth low-pass filter of a sensor, at the rate of the loop.

    $$y_k = b_0 x_k + b_1 x_{k-1} + b_2 x_{k-2} - a_1 y_{k-1} - a_2 y_{k-2}$$

    The firmware runs it at the rate of the gyro, from 1 kHz, which `at_loop_rate` represents. List
    it before the controller that reads its output.

    Source: LowPassFilter2p.cpp of ArduPilot 4.6 and of PX4 1.15; filter.c of Betaflight 4.5 (the
    biquad). The coefficients are the bilinear transform of $1 / (s^2 + \sqrt 2 s + 1)$.
    """

    states, inputs, setpoints, outputs = ("x1", "x2"), ("raw",), (), ("filtered",)
    cutoff = gb.Parameter(20.0, bounds=(0.1, 4000), unit="Hz", about="cutoff of the filter")
    gyro_rate = gb.Parameter(0.0, bounds=(0, 32000), unit="Hz", about="0: the rate of the loop")

    def update(self, x, u, p):
        cutoff = at_loop_rate(p.cutoff, self.rate, p.gyro_rate)
        state, output = biquad((x.x1, x.x2), u.raw, *butterworth(cutoff, self.rate))
        return state, (output,)


class SampledLag(gb.Controller):
    r"""First-order low-pass filter of a sensor: PT1 of Betaflight; PT2 and PT3 are several.

    $$y_k = y_{k-1} + \frac{2\pi f_c h}{1 + 2\pi f_c h} (x_k - y_{k-1})$$

    Source: filter.c of Betaflight 4.5 (pt1FilterGain).
    """

    states, inputs, setpoints, outputs = ("y",), ("raw",), (), ("filtered",)
    cutoff = gb.Parameter(20.0, bounds=(0.1, 4000), unit="Hz", about="cutoff of the filter")

    def update(self, x, u, p):
        y = x.y + smoothing(p.cutoff, self.rate) * (u.raw - x.y)
        return (y,), (y,)


class SampledNotch(gb.Controller):
    r"""Notch filter of a sensor, at the rate of the loop.

    $$F(z) = \frac{1 + \alpha A^2 - 2 \cos\omega_0 z^{-1} + (1 - \alpha A^2) z^{-2}}{1 + \alpha - 2
    \cos\omega_0 z^{-1} + (1 - \alpha) z^{-2}}, \qquad \alpha = \frac{\sin\omega_0}{2 Q}, \quad A =
    10^{-attenuation/40}$$

    Source: NotchFilter.cpp of ArduPilot 4.6, after R. Bristow-Johnson, Cookbook formulae for audio
    equalizer filters; with a large attenuation, NotchFilter.hpp of PX4 and filter.c of Betaflight.
    """

    states, inputs, setpoints, outputs = ("x1", "x2"), ("raw",), (), ("filtered",)
    center = gb.Parameter(80.0, bounds=(1, 4000), unit="Hz", about="center")
    quality = gb.Parameter(2.0, bounds=(0.1, 100), unit="1", about="center over bandwidth")
    attenuation = gb.Parameter(40.0, bounds=(0, 300), unit="dB", about="at the center")
    gyro_rate = gb.Parameter(0.0, bounds=(0, 32000), unit="Hz", about="0: the rate of the loop")

    def update(self, x, u, p):
        center = at_loop_rate(p.center, self.rate, p.gyro_rate)
        b, a = notch(center, p.quality, p.attenuation, self.rate)
        state, output = biquad((x.x1, x.x2), u.raw, b, a)
        return state, (output,)
