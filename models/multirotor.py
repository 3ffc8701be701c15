"""Multirotors: the rigid body, (2.1) and (2.2), its rotors, (2.3) and (4.21), drag and sensors.

Each piece is a function of states, inputs and parameters by name. A model of your own takes the
pieces that it needs; `Multirotor` combines them all. Body axes point forward, left and up from the
center of mass, as in (2.3), and the z axis of the world points up. For axes that point forward,
right and down, change the signs of y and z.

Thrust and inertia are per mass (m/s² and m²), because no flight determines a mass.
"""

import math
from dataclasses import replace
from types import SimpleNamespace

import greybox as gb

ANGLES, QUATERNION = ("phi", "theta", "psi"), ("q_w", "q_x", "q_y", "q_z")
RATES, VELOCITY, POSITION = ("p", "q", "r"), ("v_x", "v_y", "v_z"), ("x", "y", "z")
SPECIFIC_FORCE = ("a_x", "a_y", "a_z")
UNITS = {
    **dict.fromkeys(ANGLES, "rad"),
    **dict.fromkeys(QUATERNION, "1"),
    **dict.fromkeys(RATES, "rad/s"),
    **dict.fromkeys(VELOCITY, "m/s"),
    **dict.fromkeys(POSITION, "m"),
    **dict.fromkeys(SPECIFIC_FORCE, "m/s²"),
}

# --- rigid body


def euler_rates(angles, rates):
    """Return the derivatives of phi, theta and psi, (2.1)."""
    sine = gb.sin(angles.phi)
    cosine = gb.cos(angles.phi)
    turn = sine * rates.q + cosine * rates.r  # rad/s, heading rate times cos(theta)
    return (
        rates.p + turn * gb.tan(angles.theta),
        cosine * rates.q - sine * rates.r,
        turn / gb.cos(angles.theta),
    )


def quaternion_rates(x, rates):
    """Return the derivatives of q_w, q_x, q_y and q_z, the rotation from the body to the world.

    The last term draws the norm back to one, which rounding would let drift.
    """
    w, i, j, k = x.q_w, x.q_x, x.q_y, x.q_z
    p, q, r = rates.p, rates.q, rates.r
    excess = 1 - (w * w + i * i + j * j + k * k)  # decays within a second
    return (
        (-i * p - j * q - k * r) / 2 + excess * w / 2,
        (w * p - k * q + j * r) / 2 + excess * i / 2,
        (k * p + w * q - i * r) / 2 + excess * j / 2,
        (-j * p + i * q + w * r) / 2 + excess * k / 2,
    )


def rotation(x):
    """Return the rows of the matrix from the body to the world, of a quaternion or of angles."""
    if hasattr(x, "q_w"):
        w, i, j, k = x.q_w, x.q_x, x.q_y, x.q_z
        return (
            (w * w + i * i - j * j - k * k, 2 * (i * j - w * k), 2 * (i * k + w * j)),
            (2 * (i * j + w * k), w * w - i * i + j * j - k * k, 2 * (j * k - w * i)),
            (2 * (i * k - w * j), 2 * (j * k + w * i), w * w - i * i - j * j + k * k),
        )
    sf, cf = gb.sin(x.phi), gb.cos(x.phi)
    st, ct = gb.sin(x.theta), gb.cos(x.theta)
    sp, cp = gb.sin(x.psi), gb.cos(x.psi)
    return (
        (ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp),
        (ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp),
        (-st, sf * ct, cf * ct),
    )


def to_world(x, vector):
    """Return a vector in body axes along the axes of the world."""
    return tuple(sum(map(_product, row, vector)) for row in rotation(x))


def to_body(x, vector):
    """Return a vector along the axes of the world in body axes."""
    columns = zip(*rotation(x), strict=True)
    return tuple(sum(map(_product, column, vector)) for column in columns)


def angular_acceleration(rates, moment, inertia):
    """Return the derivatives of p, q and r about principal axes, (2.2)."""
    p, q, r = rates.p, rates.q, rates.r
    J_x, J_y, J_z = inertia
    return (
        (J_y - J_z) / J_x * q * r + moment[0] / J_x,
        (J_z - J_x) / J_y * p * r + moment[1] / J_y,
        (J_x - J_y) / J_z * p * q + moment[2] / J_z,
    )


def accelerometer(force, rates, acceleration, place):
    """Return the specific force at a place (m) in the body, which rotation adds to."""
    omega = (rates.p, rates.q, rates.r)
    turning = _cross(omega, _cross(omega, place))
    return tuple(map(sum, zip(force, _cross(acceleration, place), turning, strict=True)))


def _product(a, b):
    return a * b


def _cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


# --- rotors


def regular_frame(number=4, arm=0.1, plus=False):
    """Return the places of rotors on a regular polygon, (x, y, direction) each.

    The first rotor is in front, of the X frame to the right of the nose; the others follow
    clockwise, seen from above. Directions alternate: 1 turns counterclockwise, -1 clockwise.
    """
    first = 0.0 if plus else math.pi / number
    turns = [first + 2 * math.pi * k / number for k in range(number)]
    return tuple(
        (arm * math.cos(turn), -arm * math.sin(turn), 1 if k % 2 == 0 else -1)
        for k, turn in enumerate(turns)
    )


def rotor_places(rotors):
    """Return the places of rotors that a model is told: places, (number, arm), or a number.

    Raises
    ------
    ValueError
        For fewer than two rotors, or what is no place.
    """
    if isinstance(rotors, int):
        places = regular_frame(rotors)
    elif len(rotors) == 2 and isinstance(rotors[0], int):
        places = regular_frame(*rotors)
    else:
        places = tuple(tuple(place) for place in rotors)
    if len(places) < 2 or any(len(place) != 3 for place in places):
        raise ValueError(
            f"rotors = {rotors!r}: give at least two, each as (x, y, direction) with x and y in m, "
            "or (number, arm), or their number."
        )
    return places


def numbered(letter, count):
    """Return the names of one signal of every rotor, w_1 to w_4."""
    return tuple(f"{letter}_{k}" for k in range(1, count + 1))


def rotor_lag(command, speed, T_rotor):
    """Return the derivative of every rotor speed, (4.21)."""
    return tuple((u - w) / T_rotor for u, w in zip(command, speed, strict=True))


def thrusts(speed, p):
    """Return the specific thrust of every rotor, m/s²: a polynomial of its speed."""
    return tuple(p.c_0 + p.c_1 * w + p.c_2 * w * w for w in speed)


def rotor_moments(places, thrust, k_m):
    """Return the moments of thrusts about the body axes, with k_m of moment per thrust, (2.3)."""
    x, y, direction = zip(*places, strict=True)
    return (
        sum(map(_product, y, thrust)),
        -sum(map(_product, x, thrust)),
        -k_m * sum(map(_product, direction, thrust)),
    )


def drag(velocity, speed, p):
    """Return the specific drag for a velocity in body axes: linear, quadratic, and of the rotors.

    The drag of a rotor is proportional to its speed and to the velocity across its axis.
    """
    across = p.a5 + p.b_rotor * sum(speed)
    v_x, v_y, v_z = velocity
    return (
        -across * v_x - p.C_x * abs(v_x) * v_x,
        -across * v_y - p.C_x * abs(v_y) * v_y,
        -p.a5_z * v_z,
    )


# --- the paper's pieces as models


class EulerKinematics(gb.StateSpace):
    r"""Euler angles from the body rates, (2.1).

    $$\begin{bmatrix} \dot\phi \\ \dot\theta \\ \dot\psi \end{bmatrix} = \begin{bmatrix}
    1 & \sin\phi \tan\theta & \cos\phi \tan\theta \\ 0 & \cos\phi & -\sin\phi \\
    0 & \sin\phi / \cos\theta & \cos\phi / \cos\theta \end{bmatrix}
    \begin{bmatrix} p \\ q \\ r \end{bmatrix}$$

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.1).
    """

    states = ANGLES
    inputs = RATES
    outputs = ANGLES

    def derivative(self, x, u, p):
        return euler_rates(x, u)

    def output(self, x, u, p):
        return (x.phi, x.theta, x.psi)


class RigidBody(gb.StateSpace):
    r"""Euler angles and body rates from the torques, (2.1) with (2.2).

    $$\begin{bmatrix} \dot p \\ \dot q \\ \dot r \end{bmatrix} = \begin{bmatrix} \frac{J_y -
    J_z}{J_x} q r \\ \frac{J_z - J_x}{J_y} p r \\ \frac{J_x - J_y}{J_z} p q \end{bmatrix} +
    \begin{bmatrix} \tau_\phi / J_x \\ \tau_\theta / J_y \\ \tau_\psi / J_z \end{bmatrix}$$

    The angles follow (2.1), see `EulerKinematics`. The body axes are principal axes. Unless the
    torques are measured, flight data determine only the ratios of the inertias to the torque gains.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.1) and (2.2).
    """

    states = (*ANGLES, *RATES)
    inputs = ("tau_phi", "tau_theta", "tau_psi")
    outputs = states
    J_x = gb.Parameter(
        0.01, bounds=(1e-4, 1), unit="kg·m²", about="inertia about body x", scale="log"
    )
    J_y = gb.Parameter(
        0.01, bounds=(1e-4, 1), unit="kg·m²", about="inertia about body y", scale="log"
    )
    J_z = gb.Parameter(
        0.02, bounds=(1e-4, 1), unit="kg·m²", about="inertia about body z", scale="log"
    )

    def derivative(self, x, u, p):
        moment = (u.tau_phi, u.tau_theta, u.tau_psi)
        inertia = (p.J_x, p.J_y, p.J_z)
        return (*euler_rates(x, x), *angular_acceleration(x, moment, inertia))

    def output(self, x, u, p):
        return (x.phi, x.theta, x.psi, x.p, x.q, x.r)


class Mixer(gb.StateSpace):
    r"""Motor controls from the thrust, roll, pitch and yaw controls, below (2.3).

    $$\begin{aligned} u_1 &= u_F - 0.5 u_\phi - 0.5 u_\theta + u_\psi, & u_2 &= u_F + 0.5 u_\phi +
    0.5 u_\theta + u_\psi, \\ u_3 &= u_F + 0.5 u_\phi - 0.5 u_\theta - u_\psi, & u_4 &= u_F - 0.5
    u_\phi + 0.5 u_\theta - u_\psi \end{aligned}$$

    A static model of the symmetric X frame. `LimitedMixer` has the limits of the controls.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, below (2.3).
    """

    inputs = ("u_F", "u_phi", "u_theta", "u_psi")
    outputs = ("u_1", "u_2", "u_3", "u_4")

    def output(self, x, u, p):
        return (
            u.u_F - 0.5 * u.u_phi - 0.5 * u.u_theta + u.u_psi,
            u.u_F + 0.5 * u.u_phi + 0.5 * u.u_theta + u.u_psi,
            u.u_F + 0.5 * u.u_phi - 0.5 * u.u_theta - u.u_psi,
            u.u_F - 0.5 * u.u_phi + 0.5 * u.u_theta - u.u_psi,
        )


class LimitedMixer(Mixer):
    r"""Motor controls within their limits, below (2.3).

    $$u_k = \mathrm{sat}(m_k(u_F, \mathrm{sat}(u_\phi, \pm 0.5), \mathrm{sat}(u_\theta, \pm 0.5),
    \mathrm{sat}(u_\psi, \pm 0.5)), 0, 1)$$

    $m_k$ are the sums of `Mixer`. Within the limits both are the same. Beyond them, each motor is
    limited by itself, so that one axis disturbs the others. A flight controller gives priority to
    some of them, which the paper does not describe.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, below (2.3).
    """

    def output(self, x, u, p):
        axes = {name: _limited(getattr(u, name), -0.5, 0.5) for name in self.inputs[1:]}
        motors = super().output(x, SimpleNamespace(u_F=u.u_F, **axes), p)
        return tuple(_limited(motor, 0, 1) for motor in motors)


def _limited(value, low, high):
    return gb.maximum(low, gb.minimum(value, high))


class Torques(gb.StateSpace):
    r"""Torques about the body axes from the four rotor speeds, (2.3).

    $$\begin{aligned} \tau_\phi &= K_\tau (\Omega_2^2 + \Omega_3^2 - \Omega_1^2 - \Omega_4^2), \\
    \tau_\theta &= K_\tau (\Omega_2^2 + \Omega_4^2 - \Omega_1^2 - \Omega_3^2), \\
    \tau_\psi &= K_\psi (\Omega_1^2 + \Omega_2^2 - \Omega_3^2 - \Omega_4^2) \end{aligned}$$

    A static model of the symmetric X frame.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.3).
    """

    inputs = ("Omega_1", "Omega_2", "Omega_3", "Omega_4")
    outputs = ("tau_phi", "tau_theta", "tau_psi")
    K_tau = gb.Parameter(
        2e-6,
        bounds=(1e-9, 1e-3),
        unit="N·m·s²",
        about="roll and pitch torque per squared speed",
        scale="log",
    )
    K_psi = gb.Parameter(
        2e-7, bounds=(1e-10, 1e-4), unit="N·m·s²", about="yaw torque per squared speed", scale="log"
    )

    def output(self, x, u, p):
        one, two, three, four = (speed**2 for speed in (u.Omega_1, u.Omega_2, u.Omega_3, u.Omega_4))
        return (
            p.K_tau * (two + three - one - four),
            p.K_tau * (two + four - one - three),
            p.K_psi * (one + two - three - four),
        )


# --- the vehicle


class Thrust(gb.StateSpace):
    r"""Specific force along the rotor axes from the commands of all rotors, (4.21).

    $$T_\Omega \dot w_k = u_k(t - T_{delay}) - w_k, \quad f_k = c_0 + c_1 w_k + c_2 w_k^2,
    \quad a_z = \sum_k f_k - a_{5z} v_z, \quad \dot v_z = a_z - a_0$$

    For an accelerometer near the center of mass. The speeds $w_k$ are those at rest for the
    commands. The climb $v_z$ slows the thrust that a step of the commands leaves, as a lag would:
    without it, the lag comes out short. $a_0$ is the mean of gravity and tilt.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (4.21).

    Parameters
    ----------
    rotors : sequence of (x, y, direction), or (number, arm), or int
        Places in m; direction 1 is counterclockwise, seen from above. A number and an arm are those
        of `regular_frame`.
    speeds : bool
        The inputs are measured rotor speeds Omega_k in krad/s, without a lag, instead of commands.
    climb : bool
        Include the climb and its drag.

    Raises
    ------
    ValueError
        For fewer than two rotors.
    """

    T_rotor = gb.Parameter(
        0.05, bounds=(0.002, 0.5), unit="s", about="rotor time constant T_Ω", scale="log"
    )
    T_delay = gb.Parameter(
        0.0, bounds=(0, 0.05), unit="s", about="controller and ESC delay", fixed=True
    )
    c_0 = gb.Parameter(
        0.0, bounds=(-10, 10), unit="m/s²", about="thrust per mass of a rotor at rest", fixed=True
    )
    c_1 = gb.Parameter(
        0.0, bounds=(-50, 50), unit="m/s²", about="thrust per mass and speed", fixed=True
    )
    c_2 = gb.Parameter(
        5.0, bounds=(0.01, 200), unit="m/s²", about="thrust per mass and squared speed"
    )
    m = gb.Parameter(1.0, bounds=(1e-3, 100), unit="kg", about="mass, by a scale", fixed=True)
    a5_z = gb.Parameter(
        0.2, bounds=(-1, 5), unit="1/s", about="linear drag along the rotor axes", fixed=True
    )
    a_0 = gb.Parameter(
        gb.g, bounds=(5, 15), unit="m/s²", about="specific force of a steady climb", fixed=True
    )
    derived = {"F_max": lambda p: p.m * (p.c_0 + p.c_1 + p.c_2)}
    # Parameters of the lag, which measured speeds do not have.
    of_lag = ("T_rotor", "T_delay", "h")
    of_climb = ("a5_z", "a_0")

    def __init__(self, rotors=4, speeds=False, climb=False):
        self.rotors = rotor_places(rotors)
        count = len(self.rotors)
        self.commands = numbered("Omega" if speeds else "u", count)
        self.lagged = () if speeds else numbered("w", count)
        self.delays = {} if speeds else dict.fromkeys(self.commands, "T_delay")
        self.climb = ("v_z",) if climb else ()
        self.leave_out((*(self.of_lag if speeds else ()), *(() if climb else self.of_climb)))
        self.declare((*self.climb, *self.lagged), self.commands, ("a_z",))

    def leave_out(self, names):
        """Remove parameters of these names from this vehicle, where it has them."""
        self.parameters = {n: value for n, value in self.parameters.items() if n not in names}

    def declare(self, states, inputs, outputs):
        """Set the signals and their units."""
        self.states, self.inputs, self.outputs = states, inputs, outputs
        named = (*inputs, *outputs)
        self.units = {name: unit for name, unit in UNITS.items() if name in named}

    @property
    def label(self):
        return f"{type(self).__name__} of {len(self.rotors)} rotors"

    def trim(self, at, p):  # type: ignore[override]  (the class has a function or None)
        """Return hover: all rotors at the speed at which their thrusts carry the vehicle."""
        moved = [name for name in at if name not in (*POSITION, "psi")]
        if moved:
            raise ValueError(
                f"the operating point of {self.label} is hover: leave out at={{{moved[0]!r}: ...}}."
            )
        share = gb.g / len(self.rotors) - p.c_0
        speed = 2 * share / (p.c_1 + gb.sqrt(p.c_1**2 + 4 * p.c_2 * share))
        point = {
            **dict.fromkeys((*self.states, *self.inputs), 0.0),
            **self.state_starts,
            **dict.fromkeys((*self.lagged, *self.commands), speed),
        }
        return {name: value for name, value in point.items() if name not in at}

    def rotor_signals(self, x, u):
        """Return the commands and the speeds of the rotors, which are the same without a lag."""
        command = [u[name] for name in self.commands]
        return command, [x[name] for name in self.lagged] or command

    def rising(self, x, u, p):
        """Return the derivatives of the rotor speeds; none without a lag."""
        return rotor_lag(*self.rotor_signals(x, u), p.T_rotor) if self.lagged else ()

    def lift(self, x, u, p):
        """Return the specific force along the rotor axes."""
        lift = sum(thrusts(self.rotor_signals(x, u)[1], p))
        return lift - p.a5_z * x.v_z if self.climb else lift

    def derivative(self, x, u, p):
        climbing = (self.lift(x, u, p) - p.a_0,) if self.climb else ()
        return (*climbing, *self.rising(x, u, p))

    def output(self, x, u, p):
        return (self.lift(x, u, p),)


class Rotation(Thrust):
    r"""Angular rates from the commands of all rotors, (2.2) and (2.3) with the lag (4.21).

    $$j \dot\omega + \omega \times j \omega = \sum_k \left( r_k \times e_z f_k - d_k e_z (k_m f_k
    + h \dot w_k) \right) + j \delta$$

    The thrusts $f_k$ of `Thrust` act at the places $r_k$ of the rotors, which turn in the
    directions $d_k$. The reaction to the acceleration of rotors, $h$, and the angular acceleration
    at rest $\delta$, such as that of a center of mass beside the middle of the rotors, are fixed at
    zero until you free them.

    Gyroscope and commands determine the inertias per thrust: hold the thrust curve that `Thrust`
    finds with an accelerometer. Of yaw they determine only the ratios of $k_m$ and $h$ to $j_z =
    s_z (j_x + j_y)$, so $s_z$ has to be stated. With the mass $m$, the derived quantities are
    absolute; at 1 kg they are per mass.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.2), (2.3) and
    (4.21).

    Parameters
    ----------
    rotors, speeds
        As of `Thrust`.
    axes : str
        The rates that are outputs, such as "pq"; the others are inputs.

    Raises
    ------
    ValueError
        For axes other than p, q and r.
    """

    j_x, j_y = (
        gb.Parameter(
            1e-3, bounds=(1e-6, 1), unit="m²", about=f"inertia per mass about {axis}", scale="log"
        )
        for axis in "xy"
    )
    s_z = gb.Parameter(
        0.93, bounds=(0.5, 1), unit="1", about="j_z over j_x + j_y, 1 for a plate", fixed=True
    )
    k_m = gb.Parameter(0.01, bounds=(-0.2, 0.2), unit="m", about="yaw moment per thrust")
    h = gb.Parameter(
        0.0,
        bounds=(-0.01, 0.01),
        unit="m²",
        about="angular momentum of a rotor per mass and speed",
        fixed=True,
    )
    delta_p, delta_q, delta_r = (
        gb.Parameter(
            0.0, bounds=(-100, 100), unit="rad/s²", about=f"{axis} acceleration at rest", fixed=True
        )
        for axis in ("roll", "pitch", "yaw")
    )
    derived = {
        **Thrust.derived,
        "J_x": lambda p: p.m * p.j_x,
        "J_y": lambda p: p.m * p.j_y,
        "J_z": lambda p: p.m * p.s_z * (p.j_x + p.j_y),
    }

    def __init__(self, rotors=4, speeds=False, axes="pqr"):
        super().__init__(rotors, speeds)
        if not axes or set(axes) - set(RATES):
            raise ValueError(f"axes = {axes!r}: give one or more of p, q and r, such as 'pq'.")
        self.axes = tuple(rate for rate in RATES if rate in axes)
        measured = tuple(rate for rate in RATES if rate not in axes)
        unused = [f"delta_{rate}" for rate in measured] + (["k_m", "h"] if "r" in measured else [])
        self.leave_out(unused)
        if "r" in measured:
            # Without yaw, nothing says how far the assumed s_z is from the truth.
            derived = {name: f for name, f in type(self).derived.items() if name != "J_z"}
            self.derived = derived  # type: ignore[misc]  (of the class; here of this vehicle)
        self.declare((*self.axes, *self.lagged), (*self.commands, *measured), self.axes)

    @property
    def exports(self):
        """How `greybox export` writes a vehicle: a function of the values for each ending."""
        from greybox.models.multirotor_export import to_mjcf, to_rotorpy  # noqa: PLC0415

        return {
            ".xml": lambda values: to_mjcf(self, values),
            ".py": lambda values: to_rotorpy(self, values),
        }

    def inertia(self, p):
        """Return the inertias per mass about x, y and z."""
        return p.j_x, p.j_y, p.s_z * (p.j_x + p.j_y)

    def turning(self, x, u, p):
        """Return the derivatives of all three rates."""
        rates = SimpleNamespace(**{r: x[r] if r in self.axes else u[r] for r in RATES})
        thrust = thrusts(self.rotor_signals(x, u)[1], p)
        roll, pitch, yaw = rotor_moments(self.rotors, thrust, p.get("k_m", 0.0))
        # Without a lag there is no acceleration of rotors.
        for (_, _, direction), rate in zip(self.rotors, self.rising(x, u, p), strict=False):
            yaw -= p.get("h", 0.0) * direction * rate
        turning = angular_acceleration(rates, (roll, pitch, yaw), self.inertia(p))
        return tuple(
            acceleration + p.get(f"delta_{rate}", 0.0)
            for rate, acceleration in zip(RATES, turning, strict=True)
        )

    def derivative(self, x, u, p):
        turning = dict(zip(RATES, self.turning(x, u, p), strict=True))
        return (*(turning[rate] for rate in self.axes), *self.rising(x, u, p))

    def output(self, x, u, p):
        return tuple(x[rate] for rate in self.axes)


class Multirotor(Rotation):
    r"""A multirotor from motor commands or rotor speeds to its sensors, (2.1) to (2.3) and (4.21).

    $$\dot v = R \left( e_z \sum_k f_k - D(R^T v) \right) - g e_z, \quad a = e_z \sum_k f_k - D(R^T
    v) + \dot\omega \times r_a + \omega \times (\omega \times r_a)$$

    Thrusts and rates are those of `Thrust` and `Rotation`, and the attitude $R$ follows (2.1) or
    is a quaternion. Velocity and position are those along the axes of the world. $D$ is `drag`. It
    and the place $r_a$ of the accelerometer are fixed at zero until you free them.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.1) to (2.3) and
    (4.21).

    Parameters
    ----------
    rotors, speeds
        As of `Thrust`.
    attitude : "", "angles" or "quaternion"
        How the attitude is described; "" leaves out attitude, velocity and drag.
    position : bool
        Add the position.

    Raises
    ------
    ValueError
        For another attitude, or a position without attitude.
    """

    a5 = gb.Parameter(
        0.0, bounds=(-1, 5), unit="1/s", about="linear drag across the rotor axes", fixed=True
    )
    a5_z = replace(Thrust.a5_z, start=0.0)
    C_x = gb.Parameter(
        0.0, bounds=(-1, 2), unit="1/m", about="drag per squared velocity", fixed=True
    )
    b_rotor = gb.Parameter(
        0.0, bounds=(-1, 2), unit="1/s", about="drag per velocity and rotor speed", fixed=True
    )
    x_a, y_a, z_a = (
        gb.Parameter(
            0.0, bounds=(-0.5, 0.5), unit="m", about=f"accelerometer, {axis} of center", fixed=True
        )
        for axis in ("forward", "left", "up")
    )
    of_motion = ("a5", "C_x", "b_rotor")

    def __init__(self, rotors=4, attitude="", position=False, speeds=False):
        if attitude not in ("", "angles", "quaternion"):
            raise ValueError(
                f"attitude = {attitude!r}: give 'angles', 'quaternion', or '' for none."
            )
        if position and not attitude:
            raise ValueError("a position needs an attitude: give 'angles' or 'quaternion'.")
        super().__init__(rotors, speeds)
        self.attitude = {"": (), "angles": ANGLES, "quaternion": QUATERNION}[attitude]
        self.position = POSITION if position else ()
        self.state_starts = {"q_w": 1.0} if attitude == "quaternion" else {}
        rigid = (*self.position, *(VELOCITY if attitude else ()), *self.attitude, *RATES)
        self.declare((*rigid, *self.lagged), self.commands, (*rigid, *SPECIFIC_FORCE))
        if attitude:
            self.parameters = {**self.parameters, "a5_z": type(self).a5_z}
        else:
            self.leave_out(self.of_motion)

    def force(self, x, u, p):
        """Return the specific force in body axes."""
        speed = self.rotor_signals(x, u)[1]
        lift = sum(thrusts(speed, p))
        if not self.attitude:
            return 0.0, 0.0, lift
        d_x, d_y, d_z = drag(to_body(x, (x.v_x, x.v_y, x.v_z)), speed, p)
        return d_x, d_y, lift + d_z

    def derivative(self, x, u, p):
        path = (x.v_x, x.v_y, x.v_z) if self.position else ()
        if self.attitude:
            a_x, a_y, a_z = to_world(x, self.force(x, u, p))
            kinematics = euler_rates if self.attitude == ANGLES else quaternion_rates
            path = (*path, a_x, a_y, a_z - gb.g, *kinematics(x, x))
        return (*path, *super().derivative(x, u, p))

    def output(self, x, u, p):
        place = (p.x_a, p.y_a, p.z_a)
        felt = accelerometer(self.force(x, u, p), x, self.turning(x, u, p), place)
        return (*(x[name] for name in self.outputs[:-3]), *felt)

    def stages(self, recordings):
        """Return how the vehicle is fitted to flight logs: see `multirotor_stages`."""
        from greybox.models.multirotor_stages import flight_stages  # noqa: PLC0415 - needs models

        return flight_stages(self.rotors, recordings)
