"""Known filters between a signal and its log."""

from dataclasses import replace
from math import pi

import greybox as gb


class LowPass(gb.TransferFunction):
    r"""Second-order low-pass filter, as flight controllers apply to their gyros.

    $$F(s) = \frac{\omega_c^2}{s^2 + 2 \zeta \omega_c s + \omega_c^2}$$

    The model of a signal q that is logged after the filter is ``plant * LowPass(20.0,
    signal="q")``; if the log states the cutoff, `prepare` keeps it in ``record.filters["q"]``.

    Source: S. Butterworth, On the theory of filter amplifiers, Wireless Engineer 7 (1930) 536-541.

    Parameters
    ----------
    cutoff : float, Hz
        Where the magnitude has dropped to 0.71, with the default damping.
    damping : float
        ζ; the default is Butterworth's.
    rate : float, Hz, optional
        Sampling rate of a digital filter: the bilinear transform of the above, prewarped at the
        cutoff, as ArduPilot's LowPassFilter2p. Its rational form needs a Padé approximation.
    signal : str, optional
        Name of the filtered signal in the data.
    """

    input, output = "raw", "filtered"
    omega_c = gb.Parameter(
        126.0, bounds=(0.1, 10000), unit="rad/s", about="cutoff ω_c of the filter", fixed=True
    )
    zeta = gb.Parameter(
        0.5**0.5, bounds=(0.01, 10), unit="1", about="damping ζ of the filter", fixed=True
    )

    def __init__(self, cutoff=20.0, damping=0.5**0.5, rate=None, signal=""):
        if rate is not None and not cutoff < rate / 2:
            raise ValueError(
                f"cutoff {cutoff} Hz is not below half the sampling rate {rate} Hz: lower it."
            )
        self.rate = rate
        if signal:
            self.input, self.output = f"{signal}_raw", signal
        declared = type(self).parameters
        self.parameters = {
            "omega_c": replace(declared["omega_c"], start=2 * pi * cutoff),
            "zeta": replace(declared["zeta"], start=damping),
        }

    def response(self, s, p):
        omega_c = p.omega_c
        derivative = s
        if self.rate is not None:
            one_sample = gb.exp(-s / self.rate)
            omega_c = gb.tan(p.omega_c / (2 * self.rate))
            derivative = (1 - one_sample) / (1 + one_sample)
        return omega_c**2 / (derivative**2 + 2 * p.zeta * omega_c * derivative + omega_c**2)


class FirstOrderLowPass(gb.TransferFunction):
    r"""First-order low-pass filter, as rate controllers apply to their target and to their D term.

    $$F(s) = \frac{\omega_1}{s + \omega_1}$$

    Source: ATC_RAT_*_FLTT, FLTE and FLTD of ArduPilot (AC_PID.cpp).

    Parameters
    ----------
    cutoff : float, Hz
        Where the magnitude has dropped to 0.71.
    """

    input, output = "raw", "filtered"
    omega_1 = gb.Parameter(
        126.0, bounds=(0.1, 10000), unit="rad/s", about="cutoff ω_1 of the filter", fixed=True
    )

    def __init__(self, cutoff=20.0):
        self.parameters = {
            "omega_1": replace(type(self).parameters["omega_1"], start=2 * pi * cutoff)
        }

    def response(self, s, p):
        return p.omega_1 / (s + p.omega_1)


class Notch(gb.TransferFunction):
    r"""Notch filter, as flight controllers apply to gyros against vibration of the propellers.

    $$F(s) = \frac{s^2 + 10^{-A/20} \frac{\omega_0}{Q} s + \omega_0^2}{s^2 + \frac{\omega_0}{Q} s +
    \omega_0^2}$$

    Its numbers are constants, not parameters: several notches in series have different ones.

    Source: NotchFilter.cpp of ArduPilot, after R. Bristow-Johnson, Cookbook formulae for audio
    equalizer filters.

    Parameters
    ----------
    center : float, Hz
    quality : float
        Q, the center over the bandwidth.
    attenuation : float, dB
        A, at the center.
    """

    input, output = "raw", "filtered"

    def __init__(self, center=80.0, quality=2.0, attenuation=40.0):
        self.omega_0 = 2 * pi * center
        self.quality = quality
        self.remainder = 10 ** (-attenuation / 20)

    def response(self, s, p):
        width = self.omega_0 / self.quality
        return (s**2 + self.remainder * width * s + self.omega_0**2) / (
            s**2 + width * s + self.omega_0**2
        )
