"""Kill a worker, the scheduler and the coordinator of a study on Dask, and count what differs.

``python benchmarks/kill_dask.py --out benchmarks/results/kill_dask.txt`` runs `greybox batch` on
two workers on this machine, kills one of them, then the scheduler, then the coordinator, each by
`kill -9`, resumes the study, and holds it against one that was made in one process.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

from kill_study import is_equal

import greybox as gb

STUDY = """
from kill_study import small

import greybox as gb
from greybox.problems import pitch_hover, rotors


def large(module, starts, seed, name):
    return gb.study.Member(module.problem(), starts, seed=seed, name=name, search="multistart")


def members():
    return [
        *map(small, range(10)),
        large(pitch_hover, 150, 0, "pitch"),
        large(rotors, 100, 0, "rotors"),
        large(pitch_hover, 150, 1, "pitch again"),
        *map(small, range(10, 20)),
    ]
"""
AT = 60, 150, 230  # runs on disk when the worker, the scheduler and the coordinator are killed
HERE = str(Path(__file__).resolve().parent)


def cluster(place):
    """Start a scheduler and two workers; return their processes and the address."""
    file = place / "scheduler.json"
    file.unlink(missing_ok=True)

    def start(*words):
        with (place / "cluster.log").open("a") as log:
            command = [sys.executable, "-m", "dask", *words, "--scheduler-file", file]
            return subprocess.Popen([*command, "--no-dashboard"], stdout=log, stderr=log)

    scheduler = start("scheduler", "--host", "127.0.0.1", "--port", "0")
    while not file.exists():
        time.sleep(0.2)
    workers = [start("worker", "--nthreads", "1", "--no-nanny") for _ in range(2)]
    time.sleep(6)  # until the workers have imported greybox
    return scheduler, workers, json.loads(file.read_text())["address"]


def stop(*processes):
    """Kill processes."""
    for process in processes:
        process.kill()
        process.wait()


def batch(place, out, *options):
    """Start a study."""
    paths = os.pathsep.join(filter(None, [HERE, os.environ.get("PYTHONPATH")]))
    return subprocess.Popen(
        [sys.executable, "-m", "greybox", "batch", "study.py", "--out", out, *options],
        cwd=place,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": paths},
    )


def stored(folder):
    """Return the number of runs on disk."""
    try:
        return sum(member.stored_runs for member in gb.study.read_study(folder).members)
    except FileNotFoundError:
        return 0


def wait(folder, count, process):
    """Wait until so many runs are on disk, or the study has ended."""
    while process.poll() is None and stored(folder) < count:
        time.sleep(0.1)


def main():
    """Kill, resume, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    title = f"kill_dask.py, greybox {version('greybox-id')}, {time.strftime('%Y-%m-%d')}"
    lines = [f"{title}, load {os.getloadavg()[0]:.1f}"]

    def say(text):
        lines.append(text)
        print(text, flush=True)

    with tempfile.TemporaryDirectory() as name:
        place, folder = Path(name), Path(name) / "killed"
        (place / "study.py").write_text(STUDY)
        batch(place, "alone").communicate()
        scheduler, workers, address = cluster(place)
        study = batch(place, "killed", "--scheduler", address)
        wait(folder, AT[0], study)
        stop(workers[0])
        say(f"worker killed at {stored(folder)} runs")
        wait(folder, AT[1], study)
        stop(scheduler)
        error = study.communicate()[1].strip()
        say(f"scheduler killed: status {study.returncode}, {error.splitlines()[-1]}")
        say("a traceback" if "Traceback" in error else "no traceback")
        stop(workers[1])
        scheduler, workers, address = cluster(place)
        study = batch(place, "killed", "--scheduler", address)
        wait(folder, AT[2], study)
        stop(study)
        say(f"coordinator killed at {stored(folder)} runs")
        study = batch(place, "killed", "--scheduler", address)
        study.communicate()
        say(f"resumed: status {study.returncode}")
        stop(scheduler, *workers)
        fits = [gb.study.read_study(place / which).members for which in ("alone", "killed")]
        different = sum(not is_equal(a.fit, b.fit) for a, b in zip(*fits, strict=True))
        say(f"{different} of {len(fits[0])} members different in any bit")
    if options.out is not None:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
