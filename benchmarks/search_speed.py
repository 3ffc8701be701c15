"""Speed of the search from many starts, against a bare loop of IPOPT as people write it.

python benchmarks/search_speed.py [--starts 1000] [--seeds 100] [--bare 100]

The bare loop minimizes one SX function of unscaled variables, the root of (4.26) smoothed by 1e-14,
with IPOPT's default options, from Latin hypercube starts. A start counts when it ended at a minimum
of its own (projected gradient of at most 1e-6 in units of the starts' box), and is a success when
its cost is within 0.1 % of the lowest that anything found.

Times are those of the processor, since machines are shared. Time per success: `gb.fit` with that
many starts, everything included but the imports, against the bare loop without the building of its
solver. Time to the global minimum: the default search, from a problem and a solver that are built,
against as many starts of the bare loop as reach the minimum in 997 of 1000 cases. The first five
are the fits of the paper; from a plain start the others, but for the joint operating points, reach
their minimum in less than half of the cases.
"""

import argparse
import math
import platform
import time
from datetime import date

import casadi as ca
import numpy as np

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.solve.multistart import multistart
from greybox.engine.solve.search_method import solver_for
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.formulation.starts import Sobol
from greybox.models.polynomial import Polynomial
from greybox.models.tilt import PAPER_G
from greybox.problems import (
    pitch_5deg,
    pitch_hover,
    pitch_operating_points,
    roll_hover,
    rotors,
    yaw_hover,
)

PAPER = (pitch_hover, roll_hover, yaw_hover, pitch_5deg, rotors)
SUCCESS = 1.001  # of the lowest cost
SURE = 0.997


class Resonances(gb.TransferFunction):
    """Two resonances with an antiresonance between them, and a delay."""

    input, output = "u", "y"
    K = gb.Parameter(1.0, bounds=(0, 20))
    w1 = gb.Parameter(5.0, bounds=(0.5, 200), unit="rad/s")
    w2 = gb.Parameter(50.0, bounds=(0.5, 200), unit="rad/s")
    wz = gb.Parameter(20.0, bounds=(0.5, 200), unit="rad/s")
    d1 = gb.Parameter(0.1, bounds=(0.001, 1))
    d2 = gb.Parameter(0.1, bounds=(0.001, 1))
    dz = gb.Parameter(0.1, bounds=(0.001, 1))
    tau = gb.Parameter(0.01, bounds=(0, 0.2), unit="s")

    def response(self, s, p):
        """Return the response."""
        above = s**2 / p.wz**2 + 2 * p.dz / p.wz * s + 1
        first = s**2 / p.w1**2 + 2 * p.d1 / p.w1 * s + 1
        second = s**2 / p.w2**2 + 2 * p.d2 / p.w2 * s + 1
        return p.K * above / (first * second) * gb.exp(-s * p.tau)


class WideTilt(gb.TransferFunction):
    """(4.25) in boxes ten times as wide as those of `greybox.models.tilt`, with a free delay."""

    input, output = "u", "theta"
    a1 = gb.Parameter(0.0, bounds=(-1000, 1000))
    a2 = gb.Parameter(3.0, bounds=(-500, 500))
    a3 = gb.Parameter(5.0, bounds=(-500, 500))
    a4 = gb.Parameter(250.0, bounds=(1, 20_000))
    T_delay = gb.Parameter(0.0042, bounds=(0, 0.5), unit="s")

    def response(self, s, p):
        """Return the response."""
        tilt = (s + 0.16) / ((s + 0.16) * (s**2 + p.a2 * s + p.a1) + PAPER_G * p.a3)
        return p.a4 * tilt / (0.048 * s + 1) * gb.exp(-s * p.T_delay)


def measured(model, values, low, high, noise=0.03, points=40):
    """Return a response with relative noise."""
    omega = np.geomspace(low, high, points)
    exact = gb.frequency_response(model, values, omega).response
    rng = np.random.default_rng(0)
    errors = noise * (rng.normal(size=points) + 1j * rng.normal(size=points))
    return gb.FrequencyResponse(omega, exact * (1 + errors), "u", "y")


def hard():
    """Return the problems on which a plain start mostly fails, by name."""
    two = {
        "K": 2.0,
        "w1": 8.0,
        "w2": 60.0,
        "wz": 25.0,
        "d1": 0.05,
        "d2": 0.03,
        "dz": 0.04,
        "tau": 0.012,
    }
    resonances = measured(Resonances(), two, 1, 150)
    return {
        "resonances": gb.Problem(Resonances(), resonances),
        "polynomial (4, 2)": gb.Problem(Polynomial(4, 2), resonances),
        "polynomial (5, 3)": gb.Problem(Polynomial(5, 3), resonances),
        "polynomial (6, 4)": gb.Problem(Polynomial(6, 4), resonances),
        "tilt, wide box": gb.Problem(WideTilt(), pitch_hover.data()),
        "operating points": pitch_operating_points.problem(),
    }


class Bare:
    """The bare loop."""

    def __init__(self, problem):
        self.problem = problem
        nlp = compile_problem(problem)
        kind = ca.SX if nlp.programs[-1].function.is_a("SXFunction") else ca.MX
        x = kind.sym("x", len(nlp.free))
        values = ca.vertcat(x, *nlp.constant_values.tolist())
        cost = 0
        for part, own in zip(nlp.parts, problem.parts, strict=True):
            response = part.functions.response(values)
            half = response.numel() // 2
            re_im = Complex(response[:half], response[half:])
            cost += part.weight * own.criterion.cost(re_im, own.response, 1e-14)
        self.cost = ca.Function("cost", [x], [cost])
        self.gradient = ca.Function("gradient", [x], [ca.gradient(cost, x)])
        quiet = {
            "print_time": False,
            "ipopt": {"print_level": 0, "sb": "yes"},
            "show_eval_warnings": False,
        }
        self.solver = ca.nlpsol("bare", "ipopt", {"x": x, "f": cost}, quiet)
        self.bounds = {"lbx": nlp.lower, "ubx": nlp.upper}
        self.parameters = {name: problem.parameters[name] for name in nlp.free}
        self.width = np.array(
            [high - low for low, high in (p.box for p in self.parameters.values())]
        )

    def run(self, number):
        """Return seconds a start, and the costs of the starts that ended at a minimum."""
        starts = Sobol(number, seed=1).draw(self.parameters)
        began = time.process_time()
        ends = [np.asarray(self.solver(x0=start, **self.bounds)["x"]).ravel() for start in starts]
        seconds = (time.process_time() - began) / number
        return seconds, [float(self.cost(x)) for x in ends if self.is_minimum(x)]

    def is_minimum(self, x):
        """Return whether the projected gradient vanishes, in units of the box."""
        gradient = np.asarray(self.gradient(x)).ravel() * self.width
        z, low, high = (
            x / self.width,
            self.bounds["lbx"] / self.width,
            self.bounds["ubx"] / self.width,
        )
        # IPOPT stays 1e-8 away from its bounds.
        return bool(np.all(np.abs(z - np.clip(z - gradient, low, high)) <= 1e-6 + 2e-8))


def time_per_success(problem, options, lowest):
    """Return seconds a success of the whole fit, and the share of its starts that are one."""
    began = time.process_time()
    fit = gb.fit(
        problem,
        Sobol(options.starts, seed=1),
        search=options.search,
        progress=False,
    )
    seconds = time.process_time() - began
    successes = sum(run.converged and run.cost <= SUCCESS * lowest for run in fit.runs)
    return seconds / max(successes, 1), successes / options.starts


def default_searches(problem, options, lowest):
    """Return median seconds of a default search, share of successes, and mean number of runs."""
    nlp = compile_problem(problem)
    parameters = {name: problem.parameters[name] for name in nlp.free}
    seconds, found, brought = [], 0, []
    solver = solver_for(nlp)
    for seed in range(options.seeds):
        starts = Sobol(200, seed).draw(parameters)
        began = time.process_time()
        search = multistart(solver, starts, promising=solver.promising)
        seconds.append(time.process_time() - began)
        found += bool(search.minima) and search.minima[0].cost <= SUCCESS * lowest
        brought.append(len(search.brought))
    return np.mean(seconds), found / options.seeds, np.mean(brought)


def main():
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--starts", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--bare", type=int, default=100)
    parser.add_argument("--search", default="batched")
    parser.add_argument("--only", nargs="+", help="names of problems")
    options = parser.parse_args()
    print(
        f"{date.today()}, greybox {gb.__version__}, casadi {ca.__version__}, python "
        f"{platform.python_version()}"
    )
    print(
        f"bare loop: {options.bare} starts; fit: {options.starts} starts; default searches: "
        f"{options.seeds} seeds"
    )
    problems = {module.__name__.rpartition(".")[2]: module.problem() for module in PAPER} | hard()
    problems = {
        name: problem
        for name, problem in problems.items()
        if not options.only or name in options.only
    }
    ratios = []
    for name, problem in problems.items():
        bare = Bare(problem)
        bare_seconds, costs = bare.run(options.bare)
        lowest = min([*costs, gb.fit(problem, 2000, seed=5, progress=False).cost])
        bare_share = sum(cost <= SUCCESS * lowest for cost in costs) / options.bare
        each, share = time_per_success(problem, options, lowest)
        ratio = bare_seconds / bare_share / each if bare_share else math.inf
        ratios += [ratio] if problem.name in [m.problem().name for m in PAPER] else []
        print(
            f"{name:18} bare {1e3 * bare_seconds:6.2f} ms a start, {100 * bare_share:3.0f} %; "
            f"fit {1e3 * each:6.3f} ms a success, {100 * share:3.0f} %: {ratio:5.1f} times",
            flush=True,
        )
        seconds, found, brought = default_searches(problem, options, lowest)
        needed = (
            math.ceil(math.log(1 - SURE) / math.log(1 - min(bare_share, 0.99)))
            if bare_share
            else math.inf
        )
        print(
            f"{'':18} default search {1e3 * seconds:6.1f} ms, {100 * found:5.1f} %, {brought:5.1f} "
            f"runs; bare loop for "
            f"{100 * SURE:.1f} %: {needed} starts, {1e3 * needed * bare_seconds:6.1f} ms: "
            f"{needed * bare_seconds / seconds:4.1f} times",
            flush=True,
        )
    if ratios:
        print(
            f"time per success, fits of the paper: {math.exp(np.mean(np.log(ratios))):.1f} times, "
            f"geometric mean"
        )


if __name__ == "__main__":
    main()
