"""Twin Otter: coefficients of the short period of a real aircraft, and another manoeuvre predicted.

python benchmarks/boards/twin_otter.py FOLDER [--output FILE]

FOLDER has `totter_lon_020213f1_018.mat` and `totter_lon_020213f1_017.mat` of SIDPAC, the programs
that accompany V. Klein and E. A. Morelli, Aircraft System Identification, AIAA 2006. They are
the author's property, so nothing of them is here but the equations and the estimates: those of
`totter_demo.m` and `totter_results.mat`, of equation error and output error, with standard errors
corrected for colored residuals. Manoeuvre 018, 8 s at 50 Hz, is fitted; 017, 6 s, is the test.

As in the programs, speed, sideslip, roll, yaw and attitude are measured inputs, and there is no
C_Zq. Two things differ. The programs damp with the measured pitch rate, here it is a state. They
hold the initial states at the first sample, here these are estimated.

The test is simulated from its first sample; biases of the outputs are removed, as in the programs.
The error is the rms over three outputs, each over its standard deviation; naive is a constant,
whose error is 1 by this definition. Standard errors of equation error are for colored residuals.
"""

import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from command import heading, parser, show
from scipy.io import loadmat

import greybox as gb

STARTS = 4
FOOT, GRAVITY = 0.3048, 32.174 * 0.3048  # m, m/s²
DEG = np.pi / 180
CHORD = 6.496063 * FOOT  # m
PUBLISHED = {  # equation error, its standard error, output error, its standard error
    "C_Za": (-6.3489, 0.0200, -6.7588, 0.0813),
    "C_Ze": (-0.6261, 0.0153, -0.4103, 0.0450),
    "C_ma": (-1.4762, 0.0224, -1.5421, 0.0185),
    "C_mq": (-36.353, 0.689, -33.232, 0.926),
    "C_me": (-1.8688, 0.0204, -1.8345, 0.0271),
}


def coefficient(start, low, high, about):
    """Return a parameter without a unit."""
    return gb.Parameter(start, bounds=(low, high), unit="1", about=about)


class TwinOtter(gb.StateSpace):
    """Angle of attack and pitch rate; the rest of the motion is measured."""

    states, outputs = ("alpha", "q"), ("alpha", "q", "a_z")
    inputs = ("elevator", "V", "slip", "p", "r", "phi", "theta", "a_x", "force", "moment", "turn")
    C_Z0 = coefficient(-0.5, -5, 5, "normal force")
    C_Za = coefficient(-5.0, -50, 50, "normal force by angle of attack")
    C_Ze = coefficient(0.0, -50, 50, "normal force by elevator")
    C_m0 = coefficient(0.0, -5, 5, "pitching moment")
    C_ma = coefficient(-1.0, -50, 50, "pitching moment by angle of attack")
    C_mq = coefficient(-20.0, -200, 200, "damping of pitch")
    C_me = coefficient(-1.0, -50, 50, "pitching moment by elevator")

    def derivative(self, x, u, p):
        """Return the rates of both; `force` and `moment` are those of a coefficient of one."""
        forward = u.V * gb.cos(x.alpha) * gb.cos(u.slip)
        side, down = u.V * gb.sin(u.slip), u.V * gb.sin(x.alpha) * gb.cos(u.slip)
        a_z = GRAVITY * self.output(x, u, p)[2]
        forward_dot = u.r * side - x.q * down - GRAVITY * gb.sin(u.theta) + u.a_x
        weight = GRAVITY * gb.cos(u.theta) * gb.cos(u.phi)
        down_dot = x.q * forward - u.p * side + weight + a_z
        coefficient = p.C_m0 + p.C_ma * x.alpha + p.C_me * u.elevator
        coefficient = coefficient + p.C_mq * x.q * CHORD / (2 * u.V)
        return (
            (down_dot * forward - down * forward_dot) / (forward**2 + down**2),
            u.turn + u.moment * coefficient,
        )

    def output(self, x, u, p):
        """Return both and the normal acceleration, in g."""
        a_z = u.force * (p.C_Z0 + p.C_Za * x.alpha + p.C_Ze * u.elevator) / GRAVITY
        return (x.alpha, x.q, a_z)


def signals(folder: Path, manoeuvre: str) -> dict[str, np.ndarray]:
    """Return the signals of a manoeuvre, and what equation error needs."""
    table = loadmat(folder / f"totter_lon_020213f1_{manoeuvre}.mat")["fdata"].T
    columns = {"slip": 3, "alpha": 4, "p": 5, "q": 6, "r": 7, "phi": 8, "theta": 9, "elevator": 14}
    result = {name: table[k - 1] * DEG for name, k in (columns | {"q_dot": 43}).items()}
    mass, lateral, pitching, vertical, product = table[47:52]
    pressure = table[26] * table[76]
    p, r = result["p"], result["r"]
    return result | {
        "V": table[1] * FOOT,
        "a_x": table[10] * GRAVITY,
        "a_z": table[12],
        "force": pressure / mass * FOOT,
        "moment": pressure * table[78] / pitching,
        "turn": ((vertical - lateral) * p * r + product * (r**2 - p**2)) / pitching,
    }


def record(flown: Mapping[str, np.ndarray], name: str) -> gb.Record:
    """Return a manoeuvre as a record, linear between samples."""
    used = {key: flown[key] for key in (*TwinOtter.inputs, *TwinOtter.outputs)}
    return gb.Record(
        0.02 * np.arange(len(flown["q"])), used, hold=dict.fromkeys(used, 0.0), name=name
    )


def colored(terms: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return least squares and standard errors for residuals correlated within a fifth of it."""
    estimate = np.linalg.lstsq(terms, value, rcond=None)[0]
    residual, n = value - terms @ estimate, len(value)
    lags = np.correlate(residual, residual, "full")[n - 1 :] / n
    lags[n // 5 :] = 0
    correlation = lags[np.abs(np.subtract.outer(np.arange(n), np.arange(n)))]
    inverse = np.linalg.inv(terms.T @ terms)
    return estimate, np.sqrt(np.diag(inverse @ terms.T @ correlation @ terms @ inverse))


def equation_error(flown: Mapping[str, np.ndarray]) -> dict[str, tuple[float, float]]:
    """Return estimates and standard errors by the regressions of the programs, with C_Zq."""
    damping = flown["q"] * CHORD / (2 * flown["V"])
    terms = np.stack([flown["alpha"], damping, flown["elevator"], np.ones_like(damping)], axis=-1)
    normal = flown["a_z"] * GRAVITY / flown["force"]
    pitching = (flown["q_dot"] - flown["turn"]) / flown["moment"]
    both = (("Z", normal), ("m", pitching))
    return {
        f"C_{row}{name}": pair
        for row, value in both
        for name, *pair in zip("aqe0", *colored(terms, value), strict=True)
    }


def error(values: Mapping[str, float], flown: gb.Record) -> float:
    """Return the rms over outputs of a simulation from the first sample, without biases."""
    initial = {name: float(flown[name][0]) for name in TwinOtter.states}
    simulated = gb.simulate(TwinOtter(), values, flown, initial=initial)
    shares = [np.var(simulated[n] - flown[n]) / np.var(flown[n]) for n in TwinOtter.outputs]
    return float(np.sqrt(np.mean(shares)))


def published(column: int, flown: Mapping[str, np.ndarray], own: Mapping[str, float]):
    """Return published estimates, whose offsets are those of trim: chosen to fit the mean here."""
    values = {name: row[column] for name, row in PUBLISHED.items()}
    alpha, elevator = flown["alpha"].mean(), flown["elevator"].mean()
    for row in "Zm":
        shift = sum(
            (own[f"C_{row}{n}"] - values[f"C_{row}{n}"]) * mean
            for n, mean in (("a", alpha), ("e", elevator))
        )
        values[f"C_{row}0"] = own[f"C_{row}0"] + shift
    return values


def board(folder: Path) -> list[str]:
    """Return the lines of the table."""
    flown, other = (signals(folder, manoeuvre) for manoeuvre in ("018", "017"))
    first = equation_error(flown)
    begin = time.process_time()
    stated = gb.Problem(TwinOtter(), record(flown, "018"))
    fit = gb.fit(stated, STARTS, progress=False, profiles=False)
    spent = time.process_time() - begin
    test = record(other, "017")
    columns = ("published EE", "equation error", "published OE", "output error")
    lines = [heading(), "", f"{'':6}" + "".join(f"{label:>20}" for label in columns)]
    for name, row in PUBLISHED.items():
        own = (fit.estimate[name], fit.standard_error[name])
        cells = (row[:2], first[name], row[2:], own)
        lines.append(f"{name:6}" + "".join(f"{f'{v:.4g} ± {e:.2g}':>20}" for v, e in cells))
    verdict = "explains its data" if fit.misfit is None or fit.misfit.explains else "misfit"
    errors = {
        "published, output error": error(published(2, flown, fit.estimate), test),
        "output error": error(fit.estimate, test),
    }
    return [
        *lines,
        f"output error: {fit.agreeing} of {STARTS} starts at the best minimum, {spent:.0f} s; "
        + verdict,
        f"{'error on 017: naive, a constant':40}{1:8.3f}",
        *(f"{label:40}{value:8.3f}" for label, value in errors.items()),
    ]


if __name__ == "__main__":
    show(board, parser(__doc__).parse_args())
