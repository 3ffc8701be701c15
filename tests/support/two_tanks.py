"""Two tanks with square-root outflow, and the inflows at which they are linearized."""

import greybox as gb


class Tanks(gb.StateSpace):
    """Two tanks with square-root outflow, two delayed inputs and direct feedthrough."""

    states = ("upper", "lower")
    inputs = ("inflow", "leak")
    outputs = ("level", "flow")
    delays = {"inflow": "T_inflow", "leak": "T_leak"}
    k = gb.Parameter(2.0, bounds=(0.1, 10))
    T_inflow = gb.Parameter(0.3, bounds=(0, 1), unit="s")
    T_leak = gb.Parameter(0.1, bounds=(0, 1), unit="s")

    def derivative(self, x, u, p):
        outflow = p.k * gb.sqrt(x.upper)
        return (u.inflow - outflow, outflow - p.k * gb.sqrt(x.lower) - u.leak)

    def output(self, x, u, p):
        return (x.lower, 3 * x.lower - 0.5 * u.leak)


AT = {"inflow": 4.0, "leak": 1.0}
