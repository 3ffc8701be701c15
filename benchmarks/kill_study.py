"""Kill a study again and again, and see what was lost: nothing that was finished for two seconds.

``python benchmarks/kill_study.py --kills 30 --out benchmarks/results/kill_study.txt`` runs a study
of responses and records on two workers and ends it by `kill -9` at random moments: the process that
runs the study, or one of its workers. After every kill all files are opened and the runs on disk
are counted; at the end the resumed study is held against one that was never interrupted.
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
from greybox.estimate.fit import fingerprint
from greybox.models.tilt import LinearTilt
from greybox.problems import pitch_hover, rotors
from greybox.study.store import StoredRuns, is_study, read_members

# Of the time of the study in one process, after which it is killed: thirty kills go through all of
# it on two workers.
SHARES = 0.003, 0.04


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


def members(starts):
    """Return the members of the study."""
    return [
        gb.study.Member(pitch_hover.problem(), starts, name="pitch", search="multistart"),
        gb.study.Member(gb.Problem(LinearTilt(), record(1)), max(starts // 20, 2), name="flight"),
        gb.study.Member(rotors.problem(), starts, name="rotors", search="multistart"),
        gb.study.Member(
            pitch_hover.problem(), starts, seed=1, name="pitch again", search="multistart"
        ),
    ]


def work(folder, starts):
    """Run the study, on two workers."""
    with gb.solve.WorkerPool(2) as workers:
        print("begins", flush=True)
        gb.batch(members(starts), folder, executor=workers, progress=False)
    print("done", flush=True)


def kept(folder, starts):
    """Read every run and every fit, and return how many runs are kept."""
    if not is_study(folder):
        return 0
    count = 0
    stored = {member.name: member for member in read_members(folder)}
    for member in members(starts):
        if member.name in stored and stored[member.name].runs:
            runs = StoredRuns(folder, member.name).known(fingerprint(member.problem, member.by))
            count += len(list(runs.values()))
        if member.name in stored and stored[member.name].answer:
            assert stored[member.name].fit is not None
    return count


def children(pid):
    """Return the numbers of the processes that a process has begun."""
    found = subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True, check=False
    )
    return [int(word) for word in found.stdout.split()]


def main():
    """Kill, count, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--starts", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--work", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work is not None:
        work(options.work, options.starts)
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
        alone = gb.batch(members(options.starts), Path(place) / "alone", progress=False)
        took = time.perf_counter() - began
        say(f"never interrupted, in one process: {took:.1f} s, {alone!r}")
        folder = Path(place) / "killed"
        command = [sys.executable, __file__, "--work", folder, "--starts", str(options.starts)]
        before = 0
        for kill in range(1, options.kills + 1):
            with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
                assert process.stdout is not None
                process.stdout.readline()
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
            now = kept(folder, options.starts)
            say(
                f"kill {kill:2d}: {what}coordinator{' (had ended)' if ended else ''}, {now} runs "
                f"on disk"
            )
            assert now >= before, "runs were lost"
            before = now
        began = time.perf_counter()
        study = gb.batch(members(options.starts), folder, progress=False)
        say(f"resumed: {time.perf_counter() - began:.1f} s, {study!r}")
        for member, wanted in zip(study.members, alone.members, strict=True):
            fit, other = member.fit, wanted.fit
            same = all(
                np.array_equal(run.estimate, twin.estimate) and run.status == twin.status
                for run, twin in zip(fit.runs, other.runs, strict=True)
            )
            equal = (
                same
                and fit.estimate == other.estimate
                and fit.standard_error == other.standard_error
            )
            say(
                f"{member.name}: {len(fit.runs)} runs, "
                f"{'equal to the last bit' if equal else 'DIFFERENT'}"
            )
    if options.out is not None:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
