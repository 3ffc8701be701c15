"""A fitted multirotor for simulators: MuJoCo's MJCF, and parameters of RotorPy.

Body axes point forward, left and up, as in both simulators. Neither has the delay of the commands.
"""

import math

import greybox as gb
from greybox.modeling.formula_arguments import Names

SPEED = 1000.0  # rad/s that stand for a full command where a simulator wants speeds


def hover_command(p, count):
    """Return the command at which the thrusts carry the vehicle."""
    share = gb.g / count - p["c_0"]
    return 2 * share / (p["c_1"] + math.sqrt(p["c_1"] ** 2 + 4 * p["c_2"] * share))


def to_mjcf(model, p):
    """Return an MJCF file whose controls are the commands, from 0 to 1, each behind its lag.

    An actuator of MuJoCo is affine in its activation, so that thrust is linear about hover. Drag
    and the reaction to accelerating rotors are left out.

    Parameters
    ----------
    model : Rotation or Multirotor
    p : mapping of name to float
    """
    hover = hover_command(p, len(model.rotors))
    slope = p["m"] * (p["c_1"] + 2 * p["c_2"] * hover)
    offset = p["m"] * (p["c_0"] + p["c_1"] * hover + p["c_2"] * hover**2) - slope * hover
    J_x, J_y, J_z = (p["m"] * j for j in model.inertia(Names(p)))
    sites, motors = [], []
    for k, (x, y, direction) in enumerate(model.rotors, 1):
        sites.append(f'      <site name="rotor_{k}" pos="{x:.9g} {y:.9g} 0"/>')
        yaw = -direction * p.get("k_m", 0.0)
        motors.append(
            f'    <general name="u_{k}" site="rotor_{k}" gear="0 0 1 0 0 {yaw:.9g}" '
            f'ctrllimited="true" ctrlrange="0 1" dyntype="filterexact" '
            f'dynprm="{p["T_rotor"]:.9g}" gaintype="fixed" gainprm="{slope:.9g}" '
            f'biastype="affine" biasprm="{offset:.9g}"/>'
        )
    reach = max(math.hypot(x, y) for x, y, _ in model.rotors)
    lines = [
        '<mujoco model="multirotor">',
        f"  <!-- hover at {hover:.4g}; without the delay of {p.get('T_delay', 0.0):.4g} s -->",
        f'  <option timestep="0.001" gravity="0 0 {-gb.g}" integrator="RK4"/>',
        "  <worldbody>",
        '    <body name="vehicle" pos="0 0 1">',
        "      <freejoint/>",
        f'      <inertial pos="0 0 0" mass="{p["m"]:.9g}" '
        f'diaginertia="{J_x:.9g} {J_y:.9g} {J_z:.9g}"/>',
        f'      <geom type="cylinder" size="{reach:.4g} {reach / 5:.4g}" mass="0" contype="0" '
        'conaffinity="0"/>',
        '      <site name="imu"/>',
        *sites,
        "    </body>",
        "  </worldbody>",
        "  <actuator>",
        *motors,
        "  </actuator>",
        "  <sensor>",
        '    <gyro name="gyro" site="imu"/>',
        '    <accelerometer name="accelerometer" site="imu"/>',
        "  </sensor>",
        "</mujoco>",
    ]
    return "\n".join(lines) + "\n"


def to_rotorpy(model, p):
    """Return a Python file with the dictionary `quad_params` of RotorPy.

    Its thrusts are proportional to the squared speed. A full command stands for 1000 rad/s, and the
    thrust is that of the fitted curve at hover; the first line says how far the curve is from it at
    full command.

    Parameters
    ----------
    model : Rotation or Multirotor
    p : mapping of name to float

    Raises
    ------
    ValueError
        For other than four rotors, which RotorPy cannot control.
    """
    if len(model.rotors) != 4:
        raise ValueError(
            f"RotorPy divides its controls among four rotors, and {model.label} has others: export "
            "it for MuJoCo, as .xml."
        )
    hover = hover_command(p, len(model.rotors))
    k_eta = p["m"] * gb.g / len(model.rotors) / (SPEED * hover) ** 2
    F_max = p["m"] * (p["c_0"] + p["c_1"] + p["c_2"])
    J_x, J_y, J_z = (p["m"] * j for j in model.inertia(Names(p)))
    places = "".join(
        f'        "r{k}": np.array([{x:.9g}, {y:.9g}, 0.0]),\n'
        for k, (x, y, _) in enumerate(model.rotors, 1)
    )
    k_m = p.get("k_m", 0.0)
    directions = [int(-direction * math.copysign(1, k_m)) for _, _, direction in model.rotors]
    values = {
        "mass": p["m"],
        "Ixx": J_x,
        "Iyy": J_y,
        "Izz": J_z,
        **dict.fromkeys(("Ixy", "Iyz", "Ixz"), 0.0),
        "num_rotors": len(model.rotors),
        "k_eta": k_eta,
        "k_m": abs(k_m) * k_eta,
        **dict.fromkeys(("c_Dx", "c_Dy", "c_Dz", "k_d", "k_z", "k_h", "k_flap"), 0.0),
        "tau_m": p["T_rotor"],
        "rotor_speed_min": 0.0,
        "rotor_speed_max": SPEED,
        "motor_noise_std": 0.0,
        # Gains of RotorPy's own loops, which no flight of ours shows.
        "k_w": 1.0,
        "k_v": 10.0,
        "kp_att": 544.0,
        "kd_att": 46.64,
    }
    error = 100 * (k_eta * SPEED**2 / F_max - 1)
    rows = "".join(f'    "{name}": {value:.9g},\n' for name, value in values.items())
    return (
        f'"""A fitted multirotor, with a thrust {error:+.2g} % off its curve at full command.'
        '"""\n\nimport numpy as np\n\nquad_params = {\n'
        f'{rows}    "rotor_pos": {{\n{places}    }},\n'
        f'    "rotor_directions": np.array({directions}),\n    "rI": np.array([0, 0, 0]),\n}}\n'
    )
