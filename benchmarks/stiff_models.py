"""Robertson's kinetics at times over eight decades, beside SciPy: starts at the minimum, seconds.

python benchmarks/stiff_models.py [--seeds 10] [--starts 10]

The rate constants spread over nine decades; the starts are drawn a decade around them. SciPy's
column is what one writes by hand: `least_squares` over the logarithms of the constants, each
simulation by LSODA with tight tolerances, finite differences. A success is an end within three
standard errors of the best end. The last column holds both answers against each other.
"""

import argparse
import time

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import greybox as gb

TRUTH = np.array([0.04, 3e7, 1e4])
TIMES = np.concatenate([[0.0], np.logspace(-3, 5, 80)])
NOISE = np.array([[0.01], [0.003], [0.01]])


class Robertson(gb.StateSpace):
    """a -> b, b + b -> c, b + c -> a (Robertson 1966); b is given in units of 1e-4."""

    states, inputs, outputs = ("a", "b", "c"), (), ("a", "many_b", "c")
    slow = gb.Parameter(0.1, bounds=(1e-3, 1), starts=(0.0126, 0.126), scale="log")
    fast = gb.Parameter(1e7, bounds=(1e5, 1e9), starts=(0.95e7, 9.5e7), scale="log")
    back = gb.Parameter(1e5, bounds=(1e2, 1e6), starts=(3.16e3, 3.16e4), scale="log")

    def derivative(self, x, u, p):
        """Return the rates of the three concentrations."""
        made, used, turned = p.slow * x.a, p.back * x.b * x.c, p.fast * x.b**2
        return (-made + used, made - used - turned, turned)

    def output(self, x, u, p):
        """Return the concentrations."""
        return (x.a, 1e4 * x.b, x.c)


def simulated(p: np.ndarray) -> np.ndarray:
    """Return the outputs (3, samples) at the constants p (3,)."""

    def slope(t, x):
        made, used, turned = p[0] * x[0], p[2] * x[1] * x[2], p[1] * x[1] ** 2
        return (-made + used, made - used - turned, turned)

    run = solve_ivp(slope, (0, TIMES[-1]), (1, 0, 0), "LSODA", TIMES, rtol=1e-8, atol=1e-13)
    return run.y * np.array([[1.0], [1e4], [1.0]])


def main() -> None:
    """Print a row for every seed, and the sums."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--starts", type=int, default=10)
    options = parser.parse_args()
    exact = simulated(TRUTH)
    begin = gb.OutputError(initial={"a": 1.0, "b": 0.0, "c": 0.0})
    sums = np.zeros(4)
    covered = 0
    print(
        "seed  greybox: at the minimum, s    SciPy: at the minimum, s   largest difference, errors"
    )
    for seed in range(options.seeds):
        random = np.random.default_rng(seed)
        measured = exact + NOISE * random.normal(size=exact.shape)
        record = gb.Record(TIMES, dict(zip(Robertson.outputs, measured, strict=True)))
        clock = time.process_time()
        fit = gb.fit(gb.Problem(Robertson(), record, begin), starts=options.starts, seed=seed)
        ours = time.process_time() - clock

        estimate = np.array([*fit.estimate.values()])
        errors = np.array([*fit.standard_error.values()])
        clock = time.process_time()
        low, high = np.log([0.0126, 0.95e7, 3.16e3]), np.log([0.126, 9.5e7, 3.16e4])
        ends = [
            least_squares(
                lambda v, y=measured: ((simulated(np.exp(v)) - y) / NOISE).ravel(),
                random.uniform(low, high),
                xtol=1e-6,
                ftol=1e-6,
                diff_step=1e-4,
            )
            for _ in range(options.starts)
        ]
        theirs = time.process_time() - clock

        best = np.exp(min(ends, key=lambda end: end.cost).x)
        off = [np.abs((np.exp(end.x) - best) / errors).max() for end in ends]
        row = len(fit.minima[0].runs), ours, sum(value < 3 for value in off), theirs
        sums += row
        covered += int(
            np.sum(
                np.abs(estimate - TRUTH)
                < [fit.interval()[n][1] - fit.estimate[n] for n in fit.free]
            )
        )
        apart = np.abs((estimate - best) / errors).max()
        numbers = f"{row[0]:8.0f}  {row[1]:14.2f}  {row[2]:16.0f}  {row[3]:12.2f}"
        print(f"{seed:4d}  {numbers}  {apart:14.2f}")
    print(f"sum   {sums[0]:8.0f}  {sums[1]:14.2f}  {sums[2]:16.0f}  {sums[3]:12.2f}")
    print(f"intervals of 95 % that contain the truth: {covered} of {3 * options.seeds}")


if __name__ == "__main__":
    main()
