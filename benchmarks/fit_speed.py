"""What `gb.fit` adds to a bare loop over a ready IPOPT solver, and what its import costs.

python benchmarks/fit_speed.py [--starts 200] [--rounds 7]

Every round measures both, one after the other, so that the ratio does not depend on how busy the
machine is. The bare loop has the same NLP, options and starts, ready-made; `gb.fit` is timed from
call to return.
"""

import argparse
import platform
import statistics
import subprocess
import sys
import time
from datetime import date

import casadi as ca
import numpy as np

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.compiled.response_part import SMOOTHING
from greybox.problems import pitch_hover


def bare_loop(solver, starts, bounds):
    """Solve from every start, as one would by hand."""
    began = time.perf_counter()
    for start in starts:
        solver(x0=start, p=SMOOTHING, **bounds)
    return time.perf_counter() - began


def whole_fit(problem, starts):
    """Fit as a user does."""
    began = time.perf_counter()
    gb.fit(problem, starts=starts, progress=False)
    return time.perf_counter() - began


def import_seconds(statement):
    """Time an import in a fresh interpreter."""
    code = f"import time; t = time.perf_counter(); {statement}; print(time.perf_counter() - t)"
    return float(
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--starts", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    print(
        f"{date.today()}, greybox {gb.__version__}, casadi {ca.__version__}, python "
        f"{platform.python_version()}"
    )
    problem = pitch_hover.problem()
    nlp = compile_problem(problem)
    quiet = {
        "print_time": False,
        "show_eval_warnings": False,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 500},
    }
    z, smoothing = ca.SX.sym("z", len(nlp.free)), ca.SX.sym("smoothing")
    cost, limits = nlp.programs[-1].explicit(z, smoothing, nlp.data)
    solver = ca.nlpsol("bare", "ipopt", {"x": z, "p": smoothing, "f": cost, "g": limits}, quiet)
    points = gb.solve.Sobol(options.starts).draw(
        {name: problem.parameters[name] for name in nlp.free}
    )
    z = nlp.scaling.to_solver(points)
    bounds = {"lbx": nlp.scaling.to_solver(nlp.lower), "ubx": nlp.scaling.to_solver(nlp.upper)}
    bare_loop(solver, z, bounds)
    pairs = [
        (whole_fit(problem, options.starts), bare_loop(solver, z, bounds))
        for _ in range(options.rounds)
    ]
    ratios = [whole / bare for whole, bare in pairs]
    print(f"gb.fit of pitch_hover, {options.starts} starts: {np.median([w for w, _ in pairs]):.3f} "
          f"s; bare loop: "
          f"{np.median([b for _, b in pairs]):.3f} s; ratio {statistics.median(ratios):.2f} "
          f"({min(ratios):.2f} to {max(ratios):.2f}), limit 1.5")  # fmt: skip
    pairs = [
        (import_seconds("import casadi, greybox"), import_seconds("import casadi"))
        for _ in range(options.rounds)
    ]
    extra = [both - casadi for both, casadi in pairs]
    print(f"import greybox: {statistics.median(extra):.3f} s more than casadi ({min(extra):.3f} to "
          f"{max(extra):.3f}), "
          "limit 0.5 s")  # fmt: skip


if __name__ == "__main__":
    main()
