"""Three structures of the drag of a vehicle that tilts; also a user's file, copied beside a study."""

import greybox as gb


class Tilting(gb.StateSpace):
    """Velocity along one axis, v' = K g tan(theta) - drag(v)."""

    states = outputs = ("v",)
    inputs = ("theta",)
    units = {"theta": "rad", "v": "m/s"}
    K = gb.Parameter(0.8, bounds=(0.2, 3), about="effectiveness of the tilt")

    def drag(self, v, p):
        """Return the deceleration by drag, m/s²."""
        return 0 * v

    def derivative(self, x, u, p):
        return (p.K * gb.g * gb.tan(u.theta) - self.drag(x.v, p),)

    def output(self, x, u, p):
        return (x.v,)


class Linear(Tilting):
    """The drag of slow flow, b v."""

    b = gb.Parameter(0.3, bounds=(0, 3), unit="1/s", about="linear drag")

    def drag(self, v, p):
        return p.b * v


class Quadratic(Tilting):
    """The drag of a body, C_x |v| v."""

    C_x = gb.Parameter(0.1, bounds=(0, 2), unit="1/m", about="quadratic drag")

    def drag(self, v, p):
        return p.C_x * abs(v) * v


class Cubic(Tilting):
    """The next odd power, c v³."""

    c = gb.Parameter(0.02, bounds=(0, 1), unit="s/m²", about="cubic drag")

    def drag(self, v, p):
        return p.c * v**3
