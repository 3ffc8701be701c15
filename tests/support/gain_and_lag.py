"""A gain, and a gain with a time constant, for tests of what models have in common."""

import greybox as gb


class Gain(gb.TransferFunction):
    r"""A number, (0.0)."""

    k = gb.Parameter(2.0, bounds=(0, 10))

    def response(self, s, p):
        return p.k


class Lag(Gain):
    """A gain with a time constant."""

    T = gb.Parameter(0.5, bounds=(0, 5), unit="s")

    def response(self, s, p):
        return super().response(s, p) / (p.T * s + 1)
