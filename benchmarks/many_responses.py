"""Thirty responses of one helicopter with 29 parameters: the default search beside SciPy.

    python benchmarks/many_responses.py [seeds]

For every case: fits at the minimum (SciPy from the truth finds it), processor seconds of a whole
fit and of its search, and SciPy's least squares with finite differences from Sobol starts. One
thread; the ratio is that of seconds for every run at the minimum.
"""

import os
import sys
import time

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc

import greybox as gb

STABILITY = {
    "Xu": -0.05, "Xq": 0.5, "Yv": -0.15, "Yp": -0.4, "Zw": -0.6, "Lv": -0.05, "Lp": -3.0, "Lq": 0.8,
    "Mu": 0.02, "Mp": -0.5, "Mq": -1.8, "Nv": 0.03, "Np": -0.2, "Nr": -0.7,
}  # fmt: skip
CONTROL = {
    "Xlon": -9.0, "Xcol": 4.0, "Ylat": 8.0, "Yped": -3.0, "Zcol": -60.0, "Llat": 30.0, "Llon": 3.0,
    "Mlat": -2.0, "Mlon": 12.0, "Ncol": -2.0, "Nped": 10.0,
}  # fmt: skip
DELAYS = {"tau_lat": 0.02, "tau_lon": 0.03, "tau_col": 0.05, "tau_ped": 0.02}
TRUTH = {**STABILITY, **CONTROL, **DELAYS}
LOW = np.array([0.0 if n in DELAYS else min(-4 * abs(v), 0.0) for n, v in TRUTH.items()])
HIGH = np.array([0.2 if n in DELAYS else 4 * abs(v) for n, v in TRUTH.items()])
OMEGA = np.geomspace(0.5, 20, 20)
AXES, SIGNALS, CONTROLS = "XYZLMN", "uvwpqr", ("lat", "lon", "col", "ped")


class Helicopter(gb.StateSpace):
    """Small perturbations of six degrees of freedom, from the derivatives above."""

    states = (*SIGNALS, "phi", "theta")
    inputs, outputs = CONTROLS, ("p", "q", "r", "ax", "ay", "az", "u", "v", "w")
    delays = {u: f"tau_{u}" for u in CONTROLS}
    locals().update(
        {
            name: gb.Parameter(0.02 if name in DELAYS else 0.7 * value, bounds=(low, high))
            for (name, value), low, high in zip(TRUTH.items(), LOW, HIGH, strict=True)
        }
    )

    def forces(self, x, u, p):
        """Return specific forces and angular accelerations by axis."""
        sums = dict.fromkeys(AXES, 0.0)
        for name in (*STABILITY, *CONTROL):
            sums[name[0]] += p[name] * (x[name[1:]] if name in STABILITY else u[name[1:]])
        return sums

    def derivative(self, x, u, p):
        """Return the equations of motion."""
        X, Y, *others = self.forces(x, u, p).values()
        return X - gb.g * x.theta, Y + gb.g * x.phi, *others, x.p, x.q

    def output(self, x, u, p):
        """Return rates, specific forces and velocities."""
        X, Y, Z, *_ = self.forces(x, u, p).values()
        return x.p, x.q, x.r, X, Y, Z, x.u, x.v, x.w


def by_numpy(values):
    """Return the responses (20, 9, 4)."""
    F = np.zeros((6, 10))
    for name, value in zip(TRUTH, values, strict=True):
        if name not in DELAYS:
            column = (*SIGNALS, *CONTROLS).index(name[1:])
            F[AXES.index(name[0]), column] = value
    A = np.zeros((8, 8))
    A[:6, :6], A[6, 3], A[7, 4], A[0, 7], A[1, 6] = F[:, :6], 1.0, 1.0, -gb.g, gb.g
    B = np.vstack([F[:, 6:], np.zeros((2, 4))])
    pencil = 1j * OMEGA[:, None, None] * np.eye(8) - A
    x = np.linalg.solve(pencil, np.broadcast_to(B, (OMEGA.size, 8, 4)))[:, :6]
    y = np.concatenate([x[:, 3:], F[:3, :6] @ x + F[:3, 6:], x[:, :3]], axis=1)
    return y * np.exp(-1j * OMEGA[:, None, None] * np.array(values[-4:]))


def case(outputs, noise, seeds):
    """Print one row."""
    exact = by_numpy([*TRUTH.values()])
    pairs = [
        (k, i)
        for k, y in enumerate(Helicopter.outputs)
        for i in range(4)
        if y in outputs and np.abs(exact[:, k, i]).max() > 1e-9
    ]
    rows, columns = np.transpose(pairs)
    at_minimum, seconds, searches, scipy_seconds, scipy_runs, scipy_minima = 0, 0.0, 0.0, 0.0, 0, 0
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        errors = random.standard_normal((2, *exact.shape)) * noise / np.sqrt(2)
        measured = exact * (1 + errors[0] + 1j * errors[1])

        def residuals(values, measured=measured):
            error = ((by_numpy(values) - measured)[:, rows, columns]).ravel()
            error = error / np.abs(measured[:, rows, columns]).ravel()
            return np.concatenate([error.real, error.imag])

        def by_scipy(start):
            found = least_squares(
                residuals, start, bounds=(LOW, HIGH), x_scale=HIGH, max_nfev=300, xtol=1e-12
            )
            return 2 * found.cost

        minimum = by_scipy(np.array([*TRUTH.values()]))
        if seed == 0:
            began = time.process_time()
            shares = qmc.Sobol(len(TRUTH), rng=0).random(4)
            costs = [by_scipy(LOW + share * (HIGH - LOW)) for share in shares]
            scipy_seconds, scipy_runs = time.process_time() - began, len(costs)
            scipy_minima = sum(cost < 1.0001 * minimum for cost in costs)

        responses = [
            gb.FrequencyResponse(
                OMEGA,
                measured[:, k, i],
                input=CONTROLS[i],
                output=Helicopter.outputs[k],
            )
            for k, i in pairs
        ]
        began = time.process_time()
        problem = gb.Problem(Helicopter(), responses, criterion=gb.SquaredRelativeError())
        fit = gb.fit(problem, profiles=False, progress=False)
        seconds += (time.process_time() - began) / seeds
        searches += float(np.nansum(fit.runs.seconds)) / seeds
        at_minimum += fit.cost <= minimum * (1 + 1e-6)

    print(
        f"{len(pairs)} responses, noise {100 * noise:g} %: {at_minimum} of {seeds} at the minimum, "
        f"{seconds:.2f} s a fit ({searches:.2f} s its runs); SciPy {scipy_seconds:.2f} s for "
        f"{scipy_runs} starts, {scipy_minima} at the minimum",
        flush=True,
    )


if __name__ == "__main__":
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    print(f"greybox {gb.__version__}, numpy {np.__version__}, processor seconds")
    for outputs in (Helicopter.outputs, Helicopter.outputs[:6]):
        for noise in (0.05, 0.15):
            case(outputs, noise, seeds)
