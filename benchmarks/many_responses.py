"""Many responses of one helicopter: the default search beside SciPy, for five structures.

    python benchmarks/many_responses.py [seeds]

For every structure: fits at the minimum (SciPy from the truth finds it), processor seconds of a
whole fit, and SciPy's least squares with finite differences from Sobol starts.
One thread. The ratio is that of SciPy's seconds for a run at the minimum to those of a whole fit.
"""

import os
import resource
import sys
import time

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc

import greybox as gb

RIGID = {
    "Xu": -0.05, "Xq": 0.5, "Yv": -0.15, "Yp": -0.4, "Zw": -0.6, "Lv": -0.05, "Lp": -3.0, "Lq": 0.8,
    "Mu": 0.02, "Mp": -0.5, "Mq": -1.8, "Nv": 0.03, "Np": -0.2, "Nr": -0.7,
    "Xlon": -9.0, "Xcol": 4.0, "Ylat": 8.0, "Yped": -3.0, "Zcol": -60.0, "Llat": 30.0, "Llon": 3.0,
    "Mlat": -2.0, "Mlon": 12.0, "Ncol": -2.0, "Nped": 10.0,
}  # fmt: skip
DELAYS = {"tau_lat": 0.02, "tau_lon": 0.03, "tau_col": 0.05, "tau_ped": 0.02}
# The tip path follows the body and the controls, and tilts the body.
ROTOR = {"La": 8.0, "Lb": 90.0, "Ma": 40.0, "Mb": -5.0, "Aa": -6.0, "Ab": 1.0, "Alon": 0.3}
ROTOR |= {"Ba": -1.0, "Bb": -6.0, "Blat": 0.35}
BY_ROTOR = ("Lp", "Lq", "Mp", "Mq", "Llat", "Llon", "Mlat", "Mlon")
FLAPPING = {**{n: v for n, v in RIGID.items() if n not in BY_ROTOR}, **ROTOR}
# Two modes of the tail boom, in the rates of roll and pitch: squared frequency and damping.
MODES = {"He": -150.0, "Hh": -1.0, "Hlat": 6.0, "Kf": -280.0, "Kk": -1.4, "Klon": 5.0}
MORE = {"Xw": 0.03, "Xr": 0.2, "Zu": -0.1, "Zq": 1.0, "Mw": 0.01, "Lped": 2.0, "Xlat": 1.0}
MORE |= {"Ycol": 1.0, "Zlon": -4.0, "Nlat": 0.5, "Lr": 0.3}
OMEGA = np.geomspace(0.5, 20, 20)
CONTROLS = ("lat", "lon", "col", "ped")
RATES, ACCELERATIONS, VELOCITIES = ("p", "q", "r"), ("ax", "ay", "az"), ("u", "v", "w")
OTHERS = ("phi", "theta", "pdot", "qdot", "rdot", "climb")


def helicopter(truth, outputs):
    """Return small perturbations of six degrees of freedom, with rotor and modes if they are in it.

    The first letter of a derivative is that of its axis, the others name a state or a control.
    """
    letters = {"X": "u", "Y": "v", "Z": "w", "L": "p", "M": "q", "N": "r", "A": "a", "B": "b"}
    letters |= {"H": "h", "K": "k"}
    axes = {n[0]: letters[n[0]] for n in truth if n not in DELAYS}
    has_modes = "H" in axes
    names = (*axes.values(), "phi", "theta", *(("e", "f") if has_modes else ()))

    def sums(x, u, p):
        """Return specific forces and angular accelerations by axis."""
        totals = dict.fromkeys(axes, 0.0)
        for name in truth:
            if name not in DELAYS:
                totals[name[0]] += p[name] * (x[name[1:]] if name[1:] in names else u[name[1:]])
        return totals

    class Helicopter(gb.StateSpace):
        states, inputs = names, CONTROLS
        delays = {u: f"tau_{u}" for u in CONTROLS}
        locals().update(
            {
                name: gb.Parameter(
                    0.02 if name in DELAYS else 0.7 * value, bounds=bounds_of(name, value)
                )
                for name, value in truth.items()
            }
        )

        def derivative(self, x, u, p):
            """Return the equations of motion."""
            totals = sums(x, u, p)
            totals["X"] -= gb.g * x.theta
            totals["Y"] += gb.g * x.phi
            if "A" in totals:
                totals["A"], totals["B"] = totals["A"] - x.q, totals["B"] - x.p
            return *totals.values(), x.p, x.q, *((x.h, x.k) if has_modes else ())

        def output(self, x, u, p):
            """Return what is measured."""
            totals = sums(x, u, p)
            values = {n: x[n] for n in names} | {"ax": totals["X"], "ay": totals["Y"]}
            values |= {"az": totals["Z"], "pdot": totals["L"], "qdot": totals["M"]}
            values |= {"rdot": totals["N"], "climb": 30.0 * x.theta - x.w}
            if has_modes:
                values["p"], values["q"] = x.p + 0.3 * x.h, x.q + 0.2 * x.k
            return [values[name] for name in self.outputs]

    Helicopter.outputs = outputs
    return Helicopter()


def bounds_of(name, value):
    """Return bounds of four times the value on both sides, of a damping on one."""
    if name in DELAYS:
        return 0.0, 0.2
    if name in ("He", "Kf"):
        return 4 * value, value / 4
    return -4 * abs(value), 4 * abs(value)


def by_numpy(model, names):
    """Return a function of the values: the responses (frequencies, outputs, inputs).

    The matrices are linear in the parameters; their parts are read from the model once.
    """

    def matrices(values):
        system = gb.modeling.linearize(model, values)
        return np.block([[system.A, system.B], [system.C, system.D]])

    zero = dict.fromkeys(names, 0.0)
    constant = matrices(zero)
    slopes = np.array([matrices({**zero, name: 1.0}) - constant for name in names])
    n = len(model.states)
    places = [names.index(model.delays[u]) for u in model.inputs]
    s = 1j * OMEGA[:, None, None]

    def responses(values):
        S = constant + np.tensordot(values, slopes, 1)
        B = np.broadcast_to(S[:n, n:], (OMEGA.size, n, len(places)))
        y = S[n:, :n] @ np.linalg.solve(s * np.eye(n) - S[:n, :n], B) + S[n:, n:]
        return y * np.exp(-s * np.asarray(values)[places])

    return responses


def case(title, truth, outputs, noise, seeds):
    """Print one row."""
    truth, model = {**truth, **DELAYS}, helicopter({**truth, **DELAYS}, outputs)
    names = [*truth]
    low, high = np.transpose([bounds_of(*item) for item in truth.items()])
    responses = by_numpy(model, names)
    exact = responses([*truth.values()])
    pairs = [
        (k, i) for k in range(len(outputs)) for i in range(4) if np.abs(exact[:, k, i]).max() > 1e-9
    ]
    rows, columns = np.transpose(pairs)
    at_minimum, seconds, scipy_seconds, scipy_runs, scipy_minima = 0, [], 0.0, 0, 0
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        errors = random.standard_normal((2, *exact.shape)) * noise / np.sqrt(2)
        measured = exact * (1 + errors[0] + 1j * errors[1])

        def residuals(values, measured=measured):
            error = ((responses(values) - measured)[:, rows, columns]).ravel()
            error = error / np.abs(measured[:, rows, columns]).ravel()
            return np.concatenate([error.real, error.imag])

        def by_scipy(start):
            found = least_squares(
                residuals, start, bounds=(low, high), x_scale=high - low, max_nfev=300, xtol=1e-12
            )
            return 2 * found.cost

        minimum = by_scipy(np.array([*truth.values()]))
        if seed == 0:
            began = time.process_time()
            shares = qmc.Sobol(len(truth), rng=0).random(4)
            costs = [by_scipy(low + share * (high - low)) for share in shares]
            scipy_seconds, scipy_runs = time.process_time() - began, len(costs)
            scipy_minima = sum(cost < 1.0001 * minimum for cost in costs)

        data = [
            gb.FrequencyResponse(OMEGA, measured[:, k, i], input=CONTROLS[i], output=outputs[k])
            for k, i in pairs
        ]
        began = time.process_time()
        problem = gb.several(model, data, criterion=gb.SquaredRelativeError())
        fit = gb.fit(problem, profiles=False, progress=False)
        seconds.append(time.process_time() - began)
        at_minimum += fit.cost <= minimum * (1 + 1e-6)

    fitted, slowest = np.median(seconds), max(seconds)
    ratio = scipy_seconds / max(scipy_minima, 0.5) / fitted * at_minimum / seeds
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(
        f"{title}: {len(model.states)} states, {len(names)} parameters, {len(pairs)} responses, "
        f"noise {100 * noise:g} %: {at_minimum} of {seeds} at the minimum, {fitted:.2f} s a fit "
        f"(slowest {slowest:.2f} s), {memory:.2f} GB; SciPy {scipy_seconds:.2f} s for "
        f"{scipy_runs} starts, {scipy_minima} at the minimum; ratio {ratio:.1f}",
        flush=True,
    )


if __name__ == "__main__":
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    print(f"greybox {gb.__version__}, numpy {np.__version__}, processor seconds (median)")
    all_outputs = (*RATES, *ACCELERATIONS, *VELOCITIES)
    for noise in (0.05, 0.15):
        case("rigid body", RIGID, all_outputs, noise, seeds)
        case("rates and accelerations", RIGID, (*RATES, *ACCELERATIONS), noise, seeds)
        case("rotor flapping", FLAPPING, all_outputs, noise, seeds)
        case("two flexible modes", {**RIGID, **MODES}, all_outputs, noise, seeds)
        case("sixty responses", {**RIGID, **MORE}, (*all_outputs, *OTHERS), noise, seeds)
