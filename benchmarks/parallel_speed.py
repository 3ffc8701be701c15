"""How well two workers are used.

A fit of a minute on one process, on two of our own, and on two of Dask's.

``python benchmarks/parallel_speed.py --rounds 3 --out benchmarks/results/parallel_speed.txt`` needs
the extra ``dask`` and a machine that does nothing else: times are those of the clock. The fit is
plain multistart of two resonances with a delay, the slowest of `search_speed.py`. Workers are warm:
they have built the solver in a short fit before. The efficiency is the time of one process over
that of two, and over two.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path

from search_speed import hard

import greybox as gb

# What the documentation of `greybox.solve.executors` says of Dask's workers: without it IPOPT takes
# twice as long.
MALLOC = {"MALLOC_TRIM_THRESHOLD_": "2000000000", "MALLOC_MMAP_THRESHOLD_": "2000000000"}
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
WORKERS = 2
LEAST = {"two processes": 0.9, "two workers of Dask": 0.8}


def dask_executor(stack):
    """Return the executor of a scheduler with two workers, each a process on this machine."""
    from distributed import Client  # noqa: PLC0415  (an extra)

    folder = stack.enter_context(tempfile.TemporaryDirectory())
    scheduler = "scheduler --host 127.0.0.1 --port 0 --no-dashboard --scheduler-file scheduler.json"
    worker = "worker --scheduler-file scheduler.json --nthreads 1 --no-dashboard --no-nanny"
    for command in (scheduler, *[worker] * WORKERS):
        process = subprocess.Popen(
            [sys.executable, "-m", "dask", *command.split()],
            cwd=folder,
            env={**os.environ, **MALLOC},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        stack.callback(process.wait)
        stack.callback(process.kill)
    client = stack.enter_context(
        Client(scheduler_file=str(Path(folder) / "scheduler.json"), timeout=120)
    )
    client.wait_for_workers(WORKERS, timeout=120)
    return client.get_executor()


def seconds(problem, starts, executor):
    """Return how long a fit takes, and its runs."""
    began = time.perf_counter()
    fit = gb.fit(
        problem,
        starts,
        seed=1,
        search="multistart",
        executor=executor,
        progress=False,
        profiles=False,
    )
    return time.perf_counter() - began, [run.cost for run in fit.runs]


def main():
    """Print times and efficiencies of every round, and their medians."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=800, help="of the fit; some take seconds")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    os.environ.update(THREADS)
    problem = hard()["resonances"]
    load = os.getloadavg()[0]
    lines = [
        f"parallel_speed.py, greybox {version('greybox-id')}, {time.strftime('%Y-%m-%d')}, load "
        f"{load:.1f}"
    ]
    found = {name: [] for name in LEAST}
    with ExitStack() as stack:
        executors = {
            "two processes": stack.enter_context(gb.solve.WorkerPool(WORKERS)),
            "two workers of Dask": dask_executor(stack),
        }
        for executor in executors.values():
            seconds(problem, 8 * WORKERS, executor)
        for _ in range(options.rounds):
            alone, costs = seconds(problem, options.starts, None)
            lines.append(f"one process {alone:.1f} s")
            for name, executor in executors.items():
                took, same = seconds(problem, options.starts, executor)
                found[name].append(alone / took / WORKERS)
                same = "the same runs" if same == costs else "OTHER RUNS"
                lines.append(f"{name} {took:.1f} s: efficiency {found[name][-1]:.2f}, {same}")
            print("\n".join(lines[-1 - len(executors) :]), flush=True)
    for name, values in found.items():
        lines.append(f"{name}: efficiency {statistics.median(values):.2f}, at least {LEAST[name]}")
        print(lines[-1])
    if options.out is not None:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
