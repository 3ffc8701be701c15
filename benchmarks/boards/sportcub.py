"""SportCub, a real fixed-wing model aircraft of 75 g: a physical model, 1.5 s from one sample.

python benchmarks/boards/sportcub.py FOLDER [--output FILE]

FOLDER has the two `.npz` files of `data` of https://github.com/jgoppert/sysid_litreview_26. That
repository states no license, so nothing of it is here.

The error is that of the benchmark: 13 states are simulated from their first values over the first
150 samples, 1.5 s; the rms error of each is divided by its range in the data, and the mean is
taken.

The files name their axes north, east, down and front, right, down. They are north, west, up and
front, left, up: as named, a bank to the right accelerates to the left, and a climb accelerates. The
table has both correlations. This script turns all states by 180° about the first axes; the error
of the benchmark is the same in both. With the axes as named, gravity acts upward, and no lift by
angle of attack fits.

Structures are compared by cross-validation on the flights for training, three folds of three, each
by three methods: equation error, `gb.regression.equation_error`; output error, `gb.fit`, which
starts there; and output error with a prior, the estimates by equation error give or take their
standard errors, which are from leaving out one flight at a time. Output error simulates each flight
from its first sample, as the benchmark does, and weights each state by its range. The prior uses
the same data as the fit: it is there because six flights of 1.5 s determine few of the moments. So
the standard errors of that fit are too small. What has the least error is fitted to all nine
flights and runs on the test flights, once. 20 coefficients are 18, drag by angle of attack, and
roll by rudder.
"""

import time
from pathlib import Path

import numpy as np
from command import estimates, heading, parser, show

import greybox as gb

SAMPLES = 150
GAP = 10.0  # s between flights in one record
FOLDS = ((0, 3, 6), (1, 4, 7), (2, 5, 8))
GRAVITY = 9.81  # m/s²
STATES = ("x_n", "y_e", "z_d", "u", "v", "w", "q_w", "q_x", "q_y", "q_z", "p", "q", "r")
INPUTS = ("throttle", "elevator", "aileron", "rudder")
PUBLISHED = 0.2131  # 6DOF-Subspace-Hankel, the best of the rows with full state
HALF_TURN = np.array([1, -1, -1, 1, -1, -1, 1, 1, -1, -1, 1, -1, -1.0])  # about the first axes


def rotation(a, b, c, d):
    """Return the rows of the matrix from the body to the world, of a quaternion a, b, c, d."""
    return (
        (1 - 2 * (c * c + d * d), 2 * (b * c - a * d), 2 * (b * d + a * c)),
        (2 * (b * c + a * d), 1 - 2 * (b * b + d * d), 2 * (c * d - a * b)),
        (2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)),
    )


def coefficient(start, size, unit, about):
    """Return a parameter with bounds of this size."""
    return gb.Parameter(start, bounds=(-size, size), unit=unit, about=about)


class SportCub(gb.StateSpace):
    r"""Rigid body with aerodynamic forces and moments that are linear in angles and rates.

    Forces are per mass and moments per inertia; those of angles and surfaces grow with the square
    of the speed, those of rates with the speed. Source: Klein and Morelli, Aircraft System
    Identification, 2nd ed., chapter 3.
    """

    states, inputs, outputs = STATES, INPUTS, STATES
    X_0 = coefficient(-0.08, 5, "1/m", "drag")
    X_a = coefficient(0.0, 5, "1/m", "drag by angle of attack")
    X_t = coefficient(2.5, 50, "m/s²", "thrust")
    Y_0 = coefficient(-0.5, 5, "m/s²", "side force, as of markers that are rolled against the wing")
    Y_b = coefficient(-0.4, 5, "1/m", "side force by sideslip")
    Z_0 = coefficient(-0.6, 5, "1/m", "lift")
    Z_a = coefficient(-1.6, 20, "1/m", "lift by angle of attack")
    L_b = coefficient(-0.6, 20, "1/m²", "roll by sideslip")
    L_da = coefficient(-0.5, 20, "1/m²", "roll by aileron")
    L_dr = coefficient(0.0, 20, "1/m²", "roll by rudder")
    L_p = coefficient(-0.8, 20, "1/m", "damping of roll")
    L_r = coefficient(0.5, 20, "1/m", "roll by yaw rate")
    M_0 = coefficient(0.0, 5, "1/m²", "pitch")
    M_a = coefficient(-0.5, 20, "1/m²", "pitch by angle of attack")
    M_de = coefficient(0.1, 20, "1/m²", "pitch by elevator")
    M_q = coefficient(-0.6, 20, "1/m", "damping of pitch")
    N_b = coefficient(0.5, 20, "1/m²", "yaw by sideslip")
    N_da = coefficient(0.2, 20, "1/m²", "yaw by aileron")
    N_dr = coefficient(-0.25, 20, "1/m²", "yaw by rudder")
    N_r = coefficient(-0.7, 20, "1/m", "damping of yaw")

    def derivative(self, x, u, p):
        """Return the rates of all states; north, east, down and front, right, down."""
        a, b, c, d = x.q_w, x.q_x, x.q_y, x.q_z
        to_north, to_east, to_down = rotation(a, b, c, d)
        gx, gy, gz = (GRAVITY * g for g in to_down)
        speed = gb.sqrt(x.u**2 + x.v**2 + x.w**2 + 0.01)
        square, attack, slip = speed**2, x.w / speed, x.v / speed
        return (
            *(row[0] * x.u + row[1] * x.v + row[2] * x.w for row in (to_north, to_east, to_down)),
            square * (p.X_0 + p.X_a * attack) + p.X_t * u.throttle + gx + x.r * x.v - x.q * x.w,
            square * p.Y_b * slip + p.Y_0 + gy + x.p * x.w - x.r * x.u,
            square * (p.Z_0 + p.Z_a * attack) + gz + x.q * x.u - x.p * x.v,
            (-b * x.p - c * x.q - d * x.r) / 2,
            (a * x.p + c * x.r - d * x.q) / 2,
            (a * x.q - b * x.r + d * x.p) / 2,
            (a * x.r + b * x.q - c * x.p) / 2,
            square * (p.L_b * slip + p.L_da * u.aileron + p.L_dr * u.rudder)
            + speed * (p.L_p * x.p + p.L_r * x.r),
            square * (p.M_0 + p.M_a * attack + p.M_de * u.elevator) + speed * p.M_q * x.q,
            square * (p.N_b * slip + p.N_da * u.aileron + p.N_dr * u.rudder) + speed * p.N_r * x.r,
        )

    def output(self, x, u, p):
        """Return all states."""
        return tuple(getattr(x, name) for name in STATES)


LEFT_OUT = {
    "18 coefficients": ("X_a", "L_dr"),
    "20 coefficients": (),
}


def flights(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time (n,), states (flights, n, 13) and inputs (flights, n, 4), axes as `STATES`."""
    with np.load(path, allow_pickle=False) as file:
        if tuple(file["direct_state_names"]) != STATES or tuple(file["input_names"]) != INPUTS:
            raise ValueError(f"{path} has other signals than {STATES} and {INPUTS}.")
        kept = slice(0, SAMPLES)
        return (
            file["time_s"][0, kept],
            file["direct_state_meas"][:, kept] * HALF_TURN,
            file["u_cmd"][:, kept],
        )


def to_world(states: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (..., 3, 3) from the body to the world."""
    matrix = rotation(*np.moveaxis(states[..., 6:10], -1, 0))
    return np.moveaxis(np.array(matrix), (0, 1), (-2, -1))


def correlations(time_axis: np.ndarray, states: np.ndarray) -> tuple[float, float]:
    """Return how bank goes with acceleration to the right, and climb with a loss of speed."""
    a, b, c, d = np.moveaxis(states[..., 6:10], -1, 0)
    bank = np.arctan2(2 * (a * b + c * d), 1 - 2 * (b * b + c * c))
    pairs = []
    for path, angle in zip(states[..., :3], bank, strict=True):
        # A quintic over the 1.5 s has little noise in its second derivative.
        quintic = [np.polyfit(time_axis, axis, 5) for axis in path.T]
        velocity, acceleration = (
            np.array([np.polyval(np.polyder(axis, order), time_axis) for axis in quintic])
            for order in (1, 2)
        )
        north, east, down = velocity / np.linalg.norm(velocity, axis=0)
        right = (north * acceleration[1] - east * acceleration[0]) / np.hypot(north, east)
        along = np.sum((north, east, down) * acceleration, axis=0)
        pairs.append((np.corrcoef(angle, right)[0, 1], np.corrcoef(-down, -along)[0, 1]))
    return tuple(np.mean(pairs, axis=0))


def shares(predicted: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Return the rms error of each state over its range; both signs of a quaternion are one."""
    predicted = predicted.copy()
    agree = np.sum(predicted[..., 6:10] * states[..., 6:10], axis=-1, keepdims=True)
    predicted[..., 6:10] *= np.where(agree < 0, -1, 1)
    error = np.sqrt(np.mean((predicted - states) ** 2, axis=(0, 1)))
    return error / np.ptp(states, axis=(0, 1))


def score(predicted: np.ndarray, states: np.ndarray) -> float:
    """Return the error of the benchmark."""
    return float(np.mean(shares(predicted, states)))


def hold(time_axis: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Predict that nothing changes."""
    return np.repeat(states[:, :1], len(time_axis), axis=1)


def straight(time_axis: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Predict a straight flight at constant speed and attitude."""
    predicted = hold(time_axis, states)
    velocity = np.einsum("nij,nj->ni", to_world(states[:, 0]), states[:, 0, 3:6])
    predicted[..., :3] += velocity[:, None] * (time_axis - time_axis[0])[None, :, None]
    predicted[..., 10:] = 0
    return predicted


def record(time_axis: np.ndarray, states: np.ndarray, inputs: np.ndarray) -> gb.Record:
    """Return a flight as a record."""
    signals = dict(zip((*STATES, *INPUTS), (*states.T, *inputs.T), strict=True))
    held = {name: np.inf if name in INPUTS else 0.0 for name in signals}
    return gb.Record(time_axis, signals, hold=held, name="flight", gaps="cut")


def first(flight: gb.Record) -> dict[str, float]:
    """Return the states of the first sample."""
    return {name: float(flight[name][0]) for name in STATES}


def by_equation_error(time_axis, states, inputs, held):
    """Fit the rates of the states."""
    length = time_axis[-1] - time_axis[0] + GAP
    joined = record(
        np.concatenate([time_axis + k * length for k in range(len(states))]),
        np.concatenate(states),
        np.concatenate(inputs),
    )
    return gb.regression.equation_error(SportCub(), joined, fixed=held)


def jackknife(estimate, time_axis, states, inputs, held) -> dict[str, float]:
    """Return standard errors of equation error, from fits that leave out one flight each."""
    flown = range(len(states))
    rest = ([j for j in flown if j != k] for k in flown)
    fits = [by_equation_error(time_axis, states[o], inputs[o], held).estimate for o in rest]
    scale = np.sqrt(len(fits) - 1)
    # Without the only flight that moves a rudder, there is no estimate of what it does.
    return {name: float(scale * np.std([f[name] for f in fits if name in f])) for name in estimate}


def by_output_error(time_axis, states, inputs, held, prior=None) -> gb.Fit:
    """Fit simulations from the first sample of each flight; every state counts by its range."""
    noise = dict(zip(STATES, np.ptp(states, axis=(0, 1)), strict=True))
    parts = []
    for x, u in zip(states, inputs, strict=True):
        flight = record(time_axis, x, u)
        criterion = gb.OutputError(noise=noise, initial=first(flight))
        stated = prior if prior and not parts else {}
        parts.append(gb.Problem(SportCub(), flight, criterion, fixed=held, prior=stated))
    start = by_equation_error(time_axis, states, inputs, held).estimate
    return gb.fit(sum(parts[1:], start=parts[0]), starts=[start], progress=False)


def by_output_error_with_prior(*flown) -> gb.Fit:
    """Fit simulations, near the estimates by equation error."""
    estimate = by_equation_error(*flown).estimate
    errors = jackknife(estimate, *flown)
    return by_output_error(*flown, prior={n: (v, errors[n]) for n, v in estimate.items()})


METHODS = {
    "equation error": by_equation_error,
    "output error": by_output_error,
    "output error, prior": by_output_error_with_prior,
}


def simulated(values, time_axis, states, inputs) -> np.ndarray:
    """Predict flights from their first sample."""
    predicted = []
    for x, u in zip(states, inputs, strict=True):
        flight = record(time_axis, x, u)
        flown = gb.simulate(SportCub(), values, flight, initial=first(flight))
        predicted.append(np.stack([flown[name] for name in STATES], axis=-1))
    return np.array(predicted)


def board(folder: Path) -> list[str]:
    """Return the lines of the table."""
    train, test = (
        flights(folder / f"sportcub_mocap_4_17_26_{part}.npz") for part in ("train", "validation")
    )
    time_axis, states, inputs = train
    lines = [heading(), "", f"{'correlations':48}bank, right  climb, slower"]
    for label, axes in {"axes as named": HALF_TURN, "turned": 1.0}.items():
        pair = correlations(time_axis, states * axes)
        lines.append(f"{label:48}{pair[0]:11.2f}{pair[1]:15.2f}")

    naive = score(straight(time_axis, states), states)
    lines += ["", "on the flights for training", f"{'naive: straight':64}{naive:.4f}"]
    errors = {}
    for label, left_out in LEFT_OUT.items():
        held = dict.fromkeys(left_out, 0.0)
        for method, fitted in METHODS.items():
            predicted = np.empty_like(states)
            for fold in map(list, FOLDS):
                others = [k for k in range(len(states)) if k not in fold]
                estimate = fitted(time_axis, states[others], inputs[others], held).estimate
                predicted[fold] = simulated(
                    held | dict(estimate), time_axis, states[fold], inputs[fold]
                )
            errors[label, method] = score(predicted, states)
            row = f"cross-validated: {label}, {method}"
            lines.append(f"{row:64}{errors[label, method]:.4f}")

    chosen = min(errors, key=lambda pair: errors[pair])
    held = dict.fromkeys(LEFT_OUT[chosen[0]], 0.0)
    fit = METHODS[chosen[1]](*train, held)
    predictions = {
        "naive: hold": hold(*test[:2]),
        "naive: straight": straight(*test[:2]),
        f"greybox: {', '.join(chosen)}": simulated(held | dict(fit.estimate), *test),
    }
    lines += ["", "on the flights for test", f"{'published, full state':64}{PUBLISHED:.4f}"]
    lines += [f"{label:64}{score(p, test[1]):.4f}" for label, p in predictions.items()]
    lines += ["", f"{'of each state':20}" + "".join(f"{name:>6}" for name in STATES)]
    for label, predicted in predictions.items():
        parts = "".join(f"{e:6.3f}" for e in shares(predicted, test[1]))
        lines.append(f"{label.partition(', ')[0].removesuffix(' coefficients'):20}{parts}")
    printed = estimates(fit, fit.estimate) if isinstance(fit, gb.Fit) else str(fit).splitlines()
    lines += ["", *printed]
    return [*lines, "", f"one start, from equation error; {time.process_time():.0f} s in all"]


if __name__ == "__main__":
    show(board, parser(__doc__).parse_args())
