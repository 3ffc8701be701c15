"""What compiled functions would buy: their share of a fit, and the paper's pitch fit by JAX.

python benchmarks/compilers.py [--tool greybox|jax] [--starts 1000]

greybox evaluates formulas without a compiler, as numpy operations on columns. The first table has
the processor time of fits, errors and judgment included, and what these evaluations take of it:
functions that cost nothing would save no more than that. It has the first and the third fit of each
kind, since the first one imports and builds.

JAX needs an environment of its own: `pip install jax`. What is timed is what one would write with
it: damped Newton steps on the cost (4.26), smoothed as in greybox, with the eigenvalues of the
Hessian made positive, clipped at the bounds; the same number of iterations from all starts at once
by `vmap`, compiled as a whole. Starts are drawn in the declared bounds. A start succeeds if its
cost ends within 0.1 % of the lowest. The second search of a process finds everything compiled.
"""

import argparse
import csv
import os
import resource
import time
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import numpy as np

TABLE = Path(__file__).parents[1] / "problems" / "data" / "table_3_1.csv"
LOW, HIGH = np.array([[-100, -50, -50, 1], [100, 50, 50, 2000]])
G, T_ROTOR, T_DELAY, A5 = 9.8065, 0.048, 0.0042, 0.16  # m/s², s, s, 1/s: those of the paper
SMOOTHING = 1e-8


def by_jax(starts, iterations):
    import jax  # noqa: PLC0415  (each tool in its own environment)
    import jax.numpy as jnp  # noqa: PLC0415

    jax.config.update("jax_enable_x64", val=True)
    omega, response = measured()
    s = 1j * omega

    def cost(z):
        a1, a2, a3, a4 = LOW + (HIGH - LOW) * z
        tilt = (s + A5) / ((s + A5) * (s**2 + a2 * s + a1) + G * a3)
        model = a4 * tilt / (T_ROTOR * s + 1) * jnp.exp(-s * T_DELAY)
        error = (model - response) / response
        return jnp.sum(jnp.sqrt(error.real**2 + error.imag**2 + SMOOTHING))

    value_and_slope, hessian = jax.value_and_grad(cost), jax.hessian(cost)

    def iteration(_, search):
        z, damping = search
        value, slope = value_and_slope(z)
        curvatures, axes = jnp.linalg.eigh(hessian(z))
        step = axes @ ((axes.T @ slope) / (jnp.abs(curvatures) + damping))
        tried = jnp.clip(z - step, 0.0, 1.0)
        is_lower = cost(tried) < value
        damping = jnp.where(is_lower, damping / 5, damping * 5)
        return jnp.where(is_lower, tried, z), damping

    @jax.jit
    @jax.vmap
    def search(z):
        return cost(jax.lax.fori_loop(0, iterations, iteration, (z, 1.0))[0])

    for kind, seed in (("first", 0), ("second", 1)):
        z = np.random.default_rng(seed).uniform(size=(starts, len(LOW)))
        begin = time.process_time()
        costs = np.asarray(search(z))
        seconds = time.process_time() - begin
        share = 100 * np.mean(costs < 1.001 * costs.min())
        print(
            f"JAX {jax.__version__}, {starts} starts, {iterations} iterations, {kind} search: "
            f"{seconds:.2f} s, {share:.0f} % at the minimum {costs.min():.6f}"
        )


def measured():
    """Return the frequencies and the response of the pitch angle in hover."""
    with TABLE.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["pitch_alpha"]]
    omega, alpha, beta = (
        np.array([float(row[name]) for row in rows])
        for name in ("omega_rad_s", "pitch_alpha", "pitch_beta")
    )
    return omega, alpha + 1j * beta


def by_greybox(starts):
    import greybox as gb  # noqa: PLC0415
    from greybox.engine.compiled.vectorized import Columns  # noqa: PLC0415
    from greybox.problems import pitch_hover, sitl_drag  # noqa: PLC0415

    evaluated = Columns.__call__
    seconds = 0.0

    def timed(*arguments):
        nonlocal seconds
        begin = time.process_time()
        try:
            return evaluated(*arguments)
        finally:
            seconds += time.process_time() - begin

    Columns.__call__ = timed
    jobs = {
        f"pitch_hover, {starts} starts": (pitch_hover, {"starts": starts}),
        "sitl_drag, default starts": (sitl_drag, {}),
    }
    for name, (problem, options) in jobs.items():
        for seed in range(3):
            seconds, begin = 0.0, time.process_time()
            fit = gb.fit(problem.problem(), seed=seed, progress=False, **options)
            whole = time.process_time() - begin
            if seed == 1:
                continue
            print(
                f"{name}, fit {seed + 1}: {whole:.2f} s, evaluations {seconds:.2f} s; without "
                f"them {whole / (whole - seconds):.2f} times as fast; {fit.agreeing} starts agree"
            )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tool", default="greybox", choices=("greybox", "jax"))
    parser.add_argument("--starts", type=int, default=1000)
    parser.add_argument("--iterations", type=int, default=100, help="of JAX")
    options = parser.parse_args()
    if options.tool == "jax":
        by_jax(options.starts, options.iterations)
    else:
        by_greybox(options.starts)
    print(f"memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB")


if __name__ == "__main__":
    main()
