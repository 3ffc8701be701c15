"""Known filters on the way of a signal into the log."""

from dataclasses import replace
from math import pi

import greybox as gb


class LowPass(gb.TransferFunction):
    r"""Second-order low-pass filter, as flight controllers put on their gyros.

    $$F(s) = \frac{\omega_c^2}{s^2 + 2 \zeta \omega_c s + \omega_c^2}$$

    A model of a signal q that was logged behind the filter is ``plant * LowPass(20.0, signal="q")``; what `prepare`
    found out about a record, `record.filters["q"]`, gives the cutoff.

    Source: S. Butterworth, On the theory of filter amplifiers, Wireless Engineer 7 (1930) 536-541.

    Parameters
    ----------
    cutoff : float, Hz
        Where the magnitude has fallen to 0.71 with the default damping.
    damping : float
        ζ; by default that of Butterworth.
    rate : float, Hz, optional
        Sampling rate of a digital filter, the bilinear transform of the above with the cutoff kept, as ArduPilot's
        LowPassFilter2p. Its rational reading needs a Padé approximation.
    signal : str, optional
        Name of the filtered signal, under which the data know it: ``plant * LowPass(20.0, signal="q")``.
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
        omega_c, derivative = p.omega_c, s
        if self.rate is not None:
            back = gb.exp(-s / self.rate)  # one sample earlier
            omega_c, derivative = gb.tan(p.omega_c / (2 * self.rate)), (1 - back) / (1 + back)
        return omega_c**2 / (derivative**2 + 2 * p.zeta * omega_c * derivative + omega_c**2)
