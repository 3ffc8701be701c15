"""Known filters on the way of a signal into the log."""

from dataclasses import replace
from math import pi

import greybox as gb


class LowPass(gb.TransferFunction):
    r"""Second-order low-pass filter, as flight controllers put on their gyros.

    $$F(s) = \frac{\omega_c^2}{s^2 + 2 \zeta \omega_c s + \omega_c^2}$$

    A model of a signal that was logged behind the filter is ``plant * LowPass(20.0)``; what `prepare` found out about a
    record, `record.filters["q"]`, gives the cutoff.

    Source: S. Butterworth, On the theory of filter amplifiers, Wireless Engineer 7 (1930) 536-541.

    Parameters
    ----------
    cutoff : float, Hz
        Where the magnitude has fallen to 0.71 with the default damping.
    damping : float
        ζ; by default that of Butterworth.
    """

    input, output = "raw", "filtered"
    omega_c = gb.Parameter(126.0, bounds=(0.1, 10000), unit="rad/s", about="cutoff ω_c of the filter", fixed=True)
    zeta = gb.Parameter(0.5**0.5, bounds=(0.01, 10), unit="1", about="damping ζ of the filter", fixed=True)

    def __init__(self, cutoff=20.0, damping=0.5**0.5):
        declared = type(self).parameters
        self.parameters = {
            "omega_c": replace(declared["omega_c"], start=2 * pi * cutoff),
            "zeta": replace(declared["zeta"], start=damping),
        }

    def response(self, s, p):
        return p.omega_c**2 / (s**2 + 2 * p.zeta * p.omega_c * s + p.omega_c**2)
