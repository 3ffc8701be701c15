"""Starts of a nonlinear aircraft in wide boxes.

One plain start, and the default search, which screens twenty.

``python benchmarks/screened_starts.py --times 10 --seeds 100 --out
benchmarks/results/screened_starts.txt`` fits the longitudinal motion of a transport (four states,
two inputs, seven outputs, 601 samples at 10 Hz, 15 parameters), in boxes of so many times the
values on both sides of zero. The equations are those of Jategaonkar, Flight Vehicle System
Identification, 2nd ed. (AIAA, 2015), test case 4; the record is simulated, with values of the size
that is known of such an aircraft, and white noise.

For every seed: one plain start, the first of twenty Sobol points, and the search that `greybox.fit`
makes by default from all of them, but without the declared values, which are the truth here. Times
are of the processor.
"""

import argparse
import os
import time
from importlib.metadata import version
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402

import greybox as gb  # noqa: E402
from greybox.engine.compiled.compiled_problem import compile_problem  # noqa: E402
from greybox.engine.solve.gauss_newton.driver import GaussNewton  # noqa: E402
from greybox.engine.solve.multistart import multistart  # noqa: E402

VALUES = {
    "CD0": 0.12, "CDV": -0.065, "CDa": 0.32, "CL0": -0.093, "CLV": 0.15, "CLa": 4.3,
    "Cm0": 0.11, "CmV": 0.004, "Cma": -0.97, "Cmq": -35.0, "Cmde": -1.5,
    "b_q": 0.001, "b_qdot": 0.002, "b_ax": 0.05, "b_az": -0.1,
}  # fmt: skip
NOISE = {"V": 0.2, "alpha": 0.002, "theta": 0.001, "q": 0.001, "qdot": 0.01, "ax": 0.03, "az": 0.1}
TRIM = {"V": 106.0, "alpha": 0.112, "theta": 0.105, "q": 0.0}
V0, MASS, TILT = 104.67, 7472.0, 0.0524  # m/s, kg, rad
AREA, MOMENT, THRUST = (
    4.028e-3,
    8.0027e-4,
    -7.0153e-6,
)  # S/m, S c/I_y, and the arm of the thrust over I_y


def coefficients(x, u, p):
    """Return drag, lift and pitching moment, and the dynamic pressure."""
    speed = (x.V - V0) / V0
    drag = p.CD0 + p.CDV * speed + p.CDa * x.alpha
    lift = p.CL0 + p.CLV * speed + p.CLa * x.alpha
    moment = p.Cm0 + p.CmV * speed + p.Cma * x.alpha + p.Cmq * 1.215 * x.q / V0 + p.Cmde * u.de
    return drag, lift, moment, 0.5 * 0.792 * x.V**2


class Longitudinal(gb.StateSpace):
    """The equations of motion in stability axes."""

    states = ("V", "alpha", "theta", "q")
    inputs = ("de", "T")
    outputs = tuple(NOISE)

    def derivative(self, x, u, p):
        """Return the derivatives of the states."""
        drag, lift, moment, pressure = coefficients(x, u, p)
        path = x.theta - x.alpha
        return (
            -AREA * pressure * drag + u.T * gb.cos(x.alpha + TILT) / MASS - gb.g * gb.sin(path),
            x.q
            + (gb.g * gb.cos(path) - AREA * pressure * lift - u.T * gb.sin(x.alpha + TILT) / MASS)
            / x.V,
            x.q,
            MOMENT * pressure * moment + THRUST * u.T,
        )

    def output(self, x, u, p):
        """Return the states as measured, the pitch acceleration and two accelerations."""
        drag, lift, moment, pressure = coefficients(x, u, p)
        forward = lift * gb.sin(x.alpha) - drag * gb.cos(x.alpha)
        down = -lift * gb.cos(x.alpha) - drag * gb.sin(x.alpha)
        return (
            x.V,
            x.alpha,
            x.theta,
            x.q + p.b_q,
            MOMENT * pressure * moment + THRUST * u.T + p.b_qdot,
            AREA * pressure * forward + u.T * np.cos(TILT) / MASS + p.b_ax,
            AREA * pressure * down - u.T * np.sin(TILT) / MASS + p.b_az,
        )


def in_boxes(times):
    """Return the model with boxes of so many times its values."""
    boxes = {
        name: gb.Parameter(value, bounds=(-times * abs(value), times * abs(value)))
        for name, value in VALUES.items()
    }
    return type("Longitudinal", (Longitudinal,), boxes)()


def flight():
    """Return a minute with steps of the elevator and of the thrust."""
    time_s = 0.1 * np.arange(601)
    elevator, thrust = np.full(601, -0.025), np.full(601, 21_000.0)
    steps = [
        (5, 8, 1),
        (8, 10, -1),
        (10, 11, 1),
        (11, 12, -1),
        (22, 24, 1),
        (24, 26, -1),
        (40, 43, -0.5),
        (43, 46, 0.5),
    ]
    for begin, end, size in steps:
        elevator[(time_s >= begin) & (time_s < end)] += 0.012 * size
    thrust[(time_s > 30) & (time_s < 45)] += 1500
    inputs = {"de": elevator, "T": thrust}
    simulated = gb.simulate(in_boxes(10), VALUES, gb.Record(time_s, inputs), initial=TRIM)
    rng = np.random.default_rng(0)
    measured = {
        name: simulated[name] + size * rng.standard_normal(601) for name, size in NOISE.items()
    }
    return gb.Record(time_s, {**inputs, **measured})


def main():
    """Compare success and time."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--times", type=float, default=10)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    problem = gb.Problem(in_boxes(options.times), flight())
    nlp = compile_problem(problem)
    solver = GaussNewton(nlp)
    best = solver.run(np.array([VALUES[name] for name in nlp.free])).cost
    parameters = {name: problem.parameters[name] for name in nlp.free}
    solver.screened(
        gb.solve.Sobol(20, options.seeds).draw(parameters)
    )  # its functions are built once
    plain, screened, runs = [], [], 0
    for seed in range(options.seeds):
        starts = gb.solve.Sobol(20, seed).draw(parameters)
        began = time.process_time()
        run = solver.run(starts[0])
        plain.append((run.converged and run.cost < best + 0.1, time.process_time() - began))
        began = time.process_time()
        search = multistart(solver, starts, promising=solver.promising)
        found = bool(search.minima) and search.minima[0].cost < best + 0.1
        screened.append((found, time.process_time() - began))
        runs += len(search.brought)
    shares = [f"{sum(found for found, _ in each)} of {options.seeds}" for each in (plain, screened)]
    times = [1e3 * np.mean([seconds for _, seconds in each]) for each in (plain, screened)]
    lines = [
        f"screened_starts.py, greybox {version('greybox-id')}, {time.strftime('%Y-%m-%d')}, boxes "
        f"of {options.times:g} "
        "times the values",
        f"plain starts: {shares[0]} end at the best minimum, {times[0]:.0f} ms each, three of them "
        f"{3 * times[0]:.0f}",
        f"searches from 20 screened starts: {shares[1]}, {times[1]:.0f} ms each, "
        f"{runs / options.seeds:.1f} runs",
    ]
    print("\n".join(lines))
    if options.out is not None:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
