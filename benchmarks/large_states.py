"""Heated rods of 20 and 100 states, beside SciPy with a simulation by CasADi: seconds, memory.

python benchmarks/large_states.py [--states 20 100] [--seeds 3]

Four parameters, 150 samples, three outputs, one start. SciPy's column is what one writes by hand:
`least_squares` with finite differences over a simulation from the known initial states, compiled by
CasADi: Runge-Kutta steps with a fold over the samples for 20 states, CVODES for 100, which are
stiff. greybox is timed with the judgment of its fit, from known initial states and, up to 20
states, from unknown ones. Imports are not counted for either. The last columns hold the answers
from known initial states against each other, in standard errors.
"""

import argparse
import resource
import time

import casadi as ca
import numpy as np
from scipy.optimize import least_squares

import greybox as gb

TRUTH = np.array([0.025, 0.03, 3e-4, 1.2])
START = np.array([0.02, 0.02, 2e-4, 1.5])
NOISE = 0.05
SAMPLES = 150


def rod(cells: int) -> type[gb.StateSpace]:
    """Return the model of a rod with this many cells, heated at one end."""

    class Rod(gb.StateSpace):
        """Conduction, losses to the air, radiation; power in units of the first gain."""

        states = tuple(f"T{k}" for k in range(cells))
        inputs, outputs = ("power",), ("hot", "middle", "cold")
        k = gb.Parameter(START[0], bounds=(1e-3, 0.2), starts=(0.01, 0.04), about="conduction")
        h = gb.Parameter(START[1], bounds=(1e-4, 1), unit="1/s", about="losses")
        r = gb.Parameter(START[2], bounds=(-0.1, 0.1), about="quadratic losses")
        b = gb.Parameter(START[3], bounds=(0.1, 10), about="gain of the heater")

        def derivative(self, x, u, p):
            """Return the rates of the temperatures."""
            return rates([getattr(x, name) for name in self.states], u.power, p.k, p.h, p.r, p.b)

        def output(self, x, u, p):
            """Return the temperatures at both ends and in the middle."""
            return tuple(getattr(x, self.states[place]) for place in (0, cells // 2, cells - 1))

    return Rod


def rates(T, power, k, h, r, b):
    """Return the rates of the temperatures of all cells."""
    wide, n = [T[0], *T, T[-1]], len(T)
    result = [
        k * n**2 * (before - 2 * here + after) - h * here - r * here**2
        for before, here, after in zip(wide, T, wide[2:], strict=False)
    ]
    return (result[0] + b * n * power / 20, *result[1:])


def simulation(cells: int, power: np.ndarray):
    """Return a function of the parameters to the outputs (3, samples), from rest."""
    x, p, ends = ca.SX.sym("x", cells), ca.SX.sym("p", 4), ca.SX.sym("u", 2)
    at = ca.SX.sym("t")
    u = ends[0] + (ends[1] - ends[0]) * at
    f = ca.vertcat(*rates(ca.vertsplit(x), u, *ca.vertsplit(p)))
    if cells <= 20:
        slope, end, count = ca.Function("slope", [x, at, ends, p], [f]), x, 24
        for step in range(count):
            h, t = 1 / count, step / count
            k1 = slope(end, t, ends, p)
            k2 = slope(end + h / 2 * k1, t + h / 2, ends, p)
            k3 = slope(end + h / 2 * k2, t + h / 2, ends, p)
            k4 = slope(end + h * k3, t + h, ends, p)
            end = end + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        sample = ca.Function("sample", [x, ends, p], [end])
    else:
        ode = {"x": x, "t": at, "p": ca.vertcat(ends, p), "ode": f}
        solver = ca.integrator("sample", "cvodes", ode, 0, 1, {"reltol": 1e-6, "abstol": 1e-6})
        X, U, P = ca.MX.sym("x", cells), ca.MX.sym("u", 2), ca.MX.sym("p", 4)
        end = solver(x0=X, p=ca.vertcat(U, P))["xf"]
        sample = ca.Function("sample", [X, U, P], [end])
    run = sample.mapaccum("run", SAMPLES - 1)
    inputs = np.array([power[:-1], power[1:]])
    places = [0, cells // 2, cells - 1]

    def outputs(p):
        states = run(np.zeros(cells), inputs, p).full()
        return np.hstack([np.zeros((3, 1)), states[places]])

    return outputs


def seconds(task):
    """Return what a task gives, and the processor seconds that it takes."""
    clock = time.process_time()
    result = task()
    return result, time.process_time() - clock


def main() -> None:
    """Print a row for every number of states and seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, nargs="+", default=[20, 100])
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    print("states seed   SciPy  greybox, known  (ratio)  unknown   apart    MB")
    for cells in (3, *options.states):  # the first makes the imports
        for seed in range(options.seeds if cells > 3 else 1):
            random = np.random.default_rng(seed)
            power = np.repeat(random.choice([0.0, 1.0, 2.0], SAMPLES // 10), 10)
            exact = simulation(cells, power)(TRUTH)
            measured = exact + NOISE * random.normal(size=exact.shape)
            model = rod(cells)()
            names = dict(zip(model.outputs, measured, strict=True))
            record = gb.Record(np.arange(SAMPLES) * 1.0, {"power": power, **names})
            rest = gb.OutputError(initial=dict.fromkeys(model.states, 0.0))

            def by_hand(power=power, cells=cells, measured=measured):
                outputs = simulation(cells, power)
                return least_squares(
                    lambda p: (outputs(p * START) - measured).ravel(),
                    np.ones(4),
                    diff_step=1e-4,
                    ftol=1e-8,
                    xtol=1e-8,
                )

            end, theirs = seconds(by_hand)
            fits, ours = [], []
            for criterion in (rest, gb.OutputError())[: 1 + (cells <= 20)]:
                problem = gb.Problem(model, record, criterion)
                fit, time_taken = seconds(lambda problem=problem: gb.fit(problem, starts=1))
                fits.append(fit)
                ours.append(time_taken)
            estimate, errors = (
                np.array([*values.values()])
                for values in (fits[0].estimate, fits[0].standard_error)
            )
            apart = np.abs((end.x * START - estimate) / errors).max()
            if cells > 3:
                memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
                state = "" if all(fit.converged for fit in fits) else ", not converged"
                unknown = f"{ours[1]:8.2f}" if len(ours) > 1 else "       -"
                print(
                    f"{cells:6d} {seed:4d} {theirs:7.2f} {ours[0]:15.2f} "
                    f"{f'({ours[0] / theirs:.1f})':>8s} {unknown} {apart:7.3f} "
                    f"{memory:5.0f}{state}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
