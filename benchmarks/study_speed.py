"""The cost of a member of a study: fit, resumption, bytes on disk, and the gain by workers.

``python benchmarks/study_speed.py --members 200 --out benchmarks/results/study_speed.txt`` fits
members of five starts each, with two parameters: responses of 20 points, and records of 300
samples. It runs them in this process, on two processes, and, with ``--by dask``, on two workers of
Dask on loopback, each in a process of its own, so that its memory is counted. The efficiency is the
time of one process over the time of two workers and over two. Resumption is processor time, which
other programs on the machine change less than the clock. Members that take longer are responses of
20 points from 60 starts by IPOPT alone.

On paper, a million members on 100 machines of 8 processors: workers fit small members as a whole,
and one process, the coordinator, sends and stores them. The processor time of the row `serial` over
that of the row `processes` is the number of workers that one coordinator can keep busy; beyond, its
time is that of the study. A folder for each of several coordinators divides it.
"""

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
import warnings
from importlib.metadata import version
from pathlib import Path

import numpy as np

import greybox as gb


class Lag(gb.StateSpace):
    """A first-order lag of a record."""

    states, inputs, outputs = ("x",), ("u",), ("y",)
    K = gb.Parameter(1.0, bounds=(0.1, 10))
    tau = gb.Parameter(0.5, bounds=(0.05, 5))

    def derivative(self, x, u, p):
        """Return the derivative."""
        return ((p.K * u.u - x.x) / p.tau,)

    def output(self, x, u, p):
        """Return the output."""
        return (x.x,)


class LagResponse(gb.TransferFunction):
    """The same lag as a transfer function."""

    K = gb.Parameter(1.0, bounds=(0.1, 10))
    tau = gb.Parameter(0.5, bounds=(0.05, 5))

    def response(self, s, p):
        """Return the response."""
        return p.K / (p.tau * s + 1)


def record(seed):
    """Return 3 s of the lag at 100 Hz with noise."""
    random, time_s = np.random.default_rng(seed), np.arange(300) * 0.01
    u, y = np.sign(np.sin(2 * time_s)), np.zeros(300)
    for k in range(299):
        y[k + 1] = y[k] + 0.01 * (2 * u[k] - y[k]) / 0.3
    return gb.Record(time_s, {"u": u, "y": y + 0.02 * random.standard_normal(300)})


def response(seed):
    """Return 20 points of the lag with errors of 2 %."""
    random, omega = np.random.default_rng(seed), np.logspace(-1, 2, 20)
    noise = random.standard_normal(20) + 1j * random.standard_normal(20)
    return gb.FrequencyResponse(omega, 2 / (0.3j * omega + 1) * (1 + 0.02 * noise))


KINDS = {
    "response": lambda seed: (gb.Problem(LagResponse(), response(seed)), 5, "batched"),
    "record": lambda seed: (gb.Problem(Lag(), record(seed)), 5, "batched"),
    "large": lambda seed: (gb.Problem(LagResponse(), response(seed)), 60, "multistart"),
}


def members(kind, count):
    """Return the members of a study."""
    made = (KINDS[kind](seed) for seed in range(count))
    return [
        gb.study.Member(problem, starts, name=f"{kind} {k}", search=search)
        for k, (problem, starts, search) in enumerate(made)
    ]


def peak():
    """Return the peak memory of this process, MB."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024 / 1e6


def timed(call):
    """Return wall and processor time of a call in this process, s."""
    began, used = time.perf_counter(), time.process_time()
    call()
    return time.perf_counter() - began, time.process_time() - used


def work(kind, count, by):
    """Fit the members, resume them, and print one line of figures."""
    warnings.simplefilter("ignore")
    listed = members(kind, count)
    with tempfile.TemporaryDirectory() as folder:
        if by == "serial":
            executor = None
        elif by == "processes":
            executor = gb.solve.WorkerPool(2)
        else:
            import dask  # noqa: PLC0415  (optional)
            from distributed import Client, LocalCluster  # noqa: PLC0415

            limits = {"MALLOC_TRIM_THRESHOLD_": 2**27, "MALLOC_MMAP_THRESHOLD_": 2**25}
            # Dask's own settings keep the matrix routines of a worker to one thread.
            key = "distributed.nanny.pre-spawn-environ"
            dask.config.set({key: {**dask.config.get(key), **limits}})
            cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
            executor = Client(cluster).get_executor()
        # The first members build what later ones share, and start the workers.
        gb.batch(members(kind, 4), Path(folder, "first"), executor=executor, progress=False)
        made = Path(folder, "study")
        wall, used = timed(lambda: gb.batch(listed, made, executor=executor, progress=False))
        memory = peak()  # before the members are listed a second time
        twice = members(kind, count)
        _, again = timed(lambda: gb.batch(twice, made, progress=False))
        size = sum(path.stat().st_size for path in made.rglob("*"))
        print(f"{wall / count} {used / count} {again / count} {size / count} {memory}")
        sys.stdout.flush()
        if executor is not None:
            executor.shutdown()


def measured(kind, count, by):
    """Return the figures of `work` in a process of its own."""
    command = [sys.executable, __file__, "--work", kind, by, "--members", str(count)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return [float(word) for word in done.stdout.split()[-5:]]


def main():
    """Measure all kinds, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--members", type=int, default=200)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=[*KINDS])
    by = ("serial", "processes", "dask")
    parser.add_argument("--by", nargs="+", choices=by, default=by[:2])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--work", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work is not None:
        work(options.work[0], options.members, options.work[1])
        return
    head = f"study_speed.py, greybox {version('greybox-id')}, {time.strftime('%Y-%m-%d')}, "
    columns = ["members of", "by", "ms", "processor ms", "resume ms", "bytes", "MB", "efficiency"]
    load = f"load {os.getloadavg()[0]:.1f}"
    lines = [f"{head}{platform.machine()}, {options.members} members, {load}", "  ".join(columns)]
    for kind in options.kinds:
        alone, fitted = None, float("nan")
        for by in options.by:
            wall, used, again, size, memory = measured(kind, options.members, by)
            alone = alone or wall
            share = "" if by == "serial" else f"{alone / wall / 2:.2f}"
            figures = (1e3 * wall, 1e3 * used, 1e3 * again, size, memory)
            digits = 1, 1, 2, 0, 0
            shown = "  ".join(f"{x:.{n}f}" for x, n in zip(figures, digits, strict=True))
            lines.append(f"{kind}  {by}  {shown}  {share}")
            print(lines[-1], flush=True)
            if by == "serial":
                fitted = used
            elif by == "processes":
                lines.append(
                    f"  on paper, a million members: {1e6 * fitted / 3600:.1f} h of one processor, "
                    f"{1e6 * fitted / 800 / 60:.1f} min of 800, {1e6 * used / 60:.0f} min of one "
                    f"coordinator, which keeps {fitted / used:.0f} workers busy"
                )
                print(lines[-1], flush=True)
    if options.out is not None:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
