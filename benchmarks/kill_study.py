"""Kill a study again and again, and see what was lost: nothing that was on disk.

``python benchmarks/kill_study.py --kills 30 --out benchmarks/results/kill_study.txt`` runs a study
of responses and records on two workers and ends it by `kill -9` at random moments: the process that
runs the study, or one of its workers. Large members have thousands of runs; ``--small`` small ones
take milliseconds each, and are written together. After every kill the runs and the answers on disk
are read and counted; at the end the resumed study is held against one that was never interrupted.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np

import greybox as gb
from greybox.assessment.fit import fingerprint
from greybox.models.tilt import LinearTilt
from greybox.problems import pitch_hover, rotors
from greybox.workflows.study.database import DATABASE, is_study
from greybox.workflows.study.members import read_members
from greybox.workflows.study.stored_runs import StoredRuns

# Of the time of the study in one process, after which it is killed once it has written: thirty
# kills go through all of it on two workers.
SHARES = 0.003, 0.04


class Lag(gb.TransferFunction):
    """A first-order lag."""

    K = gb.Parameter(1.0, bounds=(0.1, 10))
    tau = gb.Parameter(0.5, bounds=(0.05, 5))

    def response(self, s, p):
        """Return the response."""
        return p.K / (p.tau * s + 1)


def record(seed):
    """Return 30 s of a stable plant at 50 Hz: tilt and velocity with noise."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(1500) * 0.02
    control = 0.05 * np.sign(np.sin(2.0 * time_s)) + 0.02 * rng.standard_normal(time_s.size)
    flight = gb.Record(time_s, {"u": control})
    values = {name: p.start for name, p in LinearTilt().parameters.items()}
    values |= {"a1": 10.0, "a2": 3.0, "a3": 5.0}
    simulated = gb.simulate(LinearTilt(), values, flight)
    signals = {
        name: simulated[name] + 0.005 * rng.standard_normal(time_s.size) for name in ("theta", "v")
    }
    return gb.Record(time_s, {"u": control, **signals})


def small(seed):
    """Return a response of 20 points with errors of 2 %."""
    random, omega = np.random.default_rng(seed), np.logspace(-1, 2, 20)
    noise = random.standard_normal(20) + 1j * random.standard_normal(20)
    data = gb.FrequencyResponse(omega, 2 / (0.3j * omega + 1) * (1 + 0.02 * noise))
    return gb.study.Member(gb.Problem(Lag(), data), 5, name=f"small {seed}")


def members(starts, count):
    """Return the members of the study, large ones among small ones."""
    few = [small(seed) for seed in range(count)]
    return [
        *few[: count // 2],
        gb.study.Member(pitch_hover.problem(), starts, name="pitch", search="multistart"),
        gb.study.Member(gb.Problem(LinearTilt(), record(1)), max(starts // 20, 2), name="flight"),
        gb.study.Member(rotors.problem(), starts, name="rotors", search="multistart"),
        gb.study.Member(
            pitch_hover.problem(), starts, seed=1, name="pitch again", search="multistart"
        ),
        *few[count // 2 :],
    ]


def work(folder, starts, count):
    """Run the study, on two workers."""
    with gb.solve.WorkerPool(2) as workers:
        print("begins", flush=True)
        gb.batch(members(starts, count), folder, executor=workers, progress=False)
    print("done", flush=True)


def kept(folder, listed):
    """Read every run and every fit on disk, and return how many there are."""
    if not is_study(folder):
        return 0, 0
    count = answers = 0
    stored = {member.name: member for member in read_members(folder)}
    for member in listed:
        if member.name in stored and stored[member.name].runs:
            runs = StoredRuns(folder, member.name).stored(fingerprint(member.problem, member.by))
            count += len(list(runs.values()))
        if member.name in stored and stored[member.name].answer:
            assert stored[member.name].fit is not None
            answers += 1
    return count, answers


def written_at(folder):
    """Return when the database was written to, s since 1970; zero without one."""
    return (folder / DATABASE).stat().st_mtime if is_study(folder) else 0.0


def children(pid):
    """Return the numbers of the processes that a process has begun."""
    found = subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True, check=False
    )
    return [int(word) for word in found.stdout.split()]


def is_equal(fit, other):
    """Return whether two fits and all of their runs are equal to the last bit."""
    same = all(
        np.array_equal(run.estimate, twin.estimate) and run.status == twin.status
        for run, twin in zip(fit.runs, other.runs, strict=True)
    )
    values = fit.estimate, fit.standard_error, fit.cost
    return same and values == (other.estimate, other.standard_error, other.cost)


def arguments():
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--starts", type=int, default=4000)
    parser.add_argument("--small", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--work", type=Path, help=argparse.SUPPRESS)
    return parser.parse_args()


def main():
    """Kill, count, compare."""
    options = arguments()
    if options.work is not None:
        work(options.work, options.starts, options.small)
        return
    rng = random.Random(options.seed)
    lines = [
        f"kill_study.py, greybox {version('greybox-id')}, {time.strftime('%Y-%m-%d')}, "
        f"{vars(options)}"
    ]

    def say(text):
        lines.append(text)
        print(text, flush=True)

    with tempfile.TemporaryDirectory() as place:
        began = time.perf_counter()
        listed = members(options.starts, options.small)
        alone = gb.batch(listed, Path(place) / "alone", progress=False)
        took = time.perf_counter() - began
        say(f"never interrupted, in one process: {took:.1f} s, {alone!r}")
        folder = Path(place) / "killed"
        command = [sys.executable, __file__, "--work", folder, "--starts", str(options.starts)]
        command += ["--small", str(options.small)]
        before = 0, 0
        for kill in range(1, options.kills + 1):
            with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
                assert process.stdout is not None
                process.stdout.readline()
                # The start of the workers would take most of the time: wait for the first write.
                written = written_at(folder)
                while written_at(folder) == written and process.poll() is None:
                    time.sleep(0.01)
                time.sleep(rng.uniform(*SHARES) * took)
                workers = children(process.pid)
                if workers and rng.random() < 0.3:
                    os.kill(rng.choice(workers), signal.SIGKILL)
                    what = "worker, then "
                    time.sleep(1.0)
                else:
                    what = ""
                ended = process.poll() is not None
                process.kill()
            now = kept(folder, listed)
            say(
                f"kill {kill:2d}: {what}coordinator{' (had ended)' if ended else ''}, {now[0]} "
                f"runs and {now[1]} answers on disk"
            )
            assert all(map(int.__ge__, now, before)), "runs or answers were lost"
            before = now
        began = time.perf_counter()
        study = gb.batch(listed, folder, progress=False)
        say(f"resumed: {time.perf_counter() - began:.1f} s, {study!r}")
        pairs = zip(study.members, alone.members, strict=True)
        different = sum(not is_equal(member.fit, twin.fit) for member, twin in pairs)
        say(f"{different} of {len(listed)} members different in any bit")
    if options.out is not None:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
