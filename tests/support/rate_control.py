"""An angular rate and its controllers: plants of the tests of loops."""

import greybox as gb

RATE = 100.0


class RateDynamics(gb.TransferFunction):
    """Angular rate per control: K e^(-tau s) / ((s + a) (T s + 1))."""

    input, output = "u", "q"
    K = gb.Parameter(40.0, bounds=(0, 1000))
    a = gb.Parameter(2.0, bounds=(-20, 50))
    T = gb.Parameter(0.05, bounds=(0.001, 1))
    tau = gb.Parameter(0.02, bounds=(0, 0.2))

    def response(self, s, p):
        return p.K * gb.exp(-p.tau * s) / ((s + p.a) * (p.T * s + 1))


class RateLoop(gb.Controller):
    """A proportional-integral controller of the rate, whose integral is one sample late."""

    states, inputs, outputs, rate = ("integral",), ("q",), ("u",), RATE
    K_P = gb.Parameter(0.15, bounds=(0, 10))
    K_I = gb.Parameter(0.3, bounds=(0, 10))

    def update(self, x, u, p):
        error = u.reference - u.q
        return (x.integral + error / self.rate,), (p.K_P * error + p.K_I * x.integral,)


class RateLoopWithD(gb.Controller):
    """The same with a filtered derivative, of which there is more than is good."""

    states, inputs, outputs, rate = ("integral", "error", "derivative"), ("q",), ("u",), RATE
    K_P = gb.Parameter(0.15, bounds=(0, 10))
    K_I = gb.Parameter(0.3, bounds=(0, 10))
    K_D = gb.Parameter(0.012, bounds=(0, 1))

    def update(self, x, u, p):
        error = u.reference - u.q
        slope = (error - x.error) * self.rate
        derivative = x.derivative + (slope - x.derivative) / 3
        total = p.K_P * error + p.K_I * x.integral + p.K_D * derivative
        return (x.integral + error / self.rate, error, derivative), (total,)
