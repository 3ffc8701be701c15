"""Horizontal velocity from the tilt angle: the drag of (4.23) and (4.24) alone."""

import greybox as gb

PAPER_G = 9.8065  # m/s², the value of the paper, below (4.24)


class Drag(gb.StateSpace):
    r"""Horizontal velocity from the tilt angle, with linear and quadratic drag, (4.23) and (4.24).

    $$\dot v = g \tan\theta - a_5 v - C_x |v| v$$

    The first line of (4.23), with both the quadratic drag and the linear drag of (4.24). Fix one at
    zero to fit the other alone: ``fixed={"a5": 0.0}``.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (4.23) and (4.24).
    """

    states = ("v",)
    inputs = ("theta",)
    outputs = ("v",)
    units = {"theta": "rad", "v": "m/s"}
    a5 = gb.Parameter(0.2, bounds=(-1, 5), unit="1/s", about="linear drag on the velocity, (4.24)")
    C_x = gb.Parameter(0.05, bounds=(-1, 2), unit="1/m", about="drag per squared velocity, (4.23)")

    def derivative(self, x, u, p):
        return (PAPER_G * gb.tan(u.theta) - p.a5 * x.v - p.C_x * abs(x.v) * x.v,)

    def output(self, x, u, p):
        return (x.v,)
