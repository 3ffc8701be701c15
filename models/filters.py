"""Known filters between a signal and its log."""

from dataclasses import replace
from math import pi

import greybox as gb


class LowPass(gb.TransferFunction):
    r"""Second-order low-pass filter, as flight controllers apply to their gyros.

    $$F(s) = \frac{\omega_c^2}{s^2 + 2 \zeta \omega_c s + \omega_c^2}$$

    The model of a signal q that is logged after the filter is ``plant * LowPass(20.0, signal="q")``; if the log tells
    the cutoff, `prepare` keeps it in ``record.filters["q"]``.

    Source: S. Butterworth, On the theory of filter amplifiers, Wireless Engineer 7 (1930) 536-541.

    Parameters
    ----------
    cutoff : float, Hz
        Where the magnitude has dropped to 0.71, with the default damping.
    damping : float
        ζ; the default is Butterworth's.
    rate : float, Hz, optional
        Sampling rate of a digital filter: the bilinear transform of the above, prewarped at the cutoff, as ArduPilot's
        LowPassFilter2p. Its rational form needs a Padé approximation.
    signal : str, optional
        Name of the filtered signal in the data.
    """

    input, output = "raw", "filtered"
    omega_c = gb.Parameter(126.0, bounds=(0.1, 10000), unit="rad/s", about="cutoff ω_c of the filter", fixed=True)
    zeta = gb.Parameter(0.5**0.5, bounds=(0.01, 10), unit="1", about="damping ζ of the filter", fixed=True)

    def __init__(self, cutoff=20.0, damping=0.5**0.5, rate=None, signal=""):
        if rate is not None and not cutoff < rate / 2:
            raise ValueError(f"cutoff {cutoff} Hz is not below half the sampling rate {rate} Hz: lower it.")
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
