"""Memory, store and comparison of a study with very many starts.

``python benchmarks/many_starts.py --starts 1000 10000 100000 --out
benchmarks/results/many_starts.txt`` fits the tilt model of the paper from so many starts, kept in a
study, each in a process of its own, and reads the studies by ``greybox compare``. Memory is the
peak of the process; what the interpreter and the first thousand starts take is in the first line.
"""

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

import greybox as gb
from greybox.problems import pitch_hover
from greybox.workflows.study.database import DATABASE
from greybox.workflows.study.members import read_members


def peak():
    """Return the peak memory of this process, MB."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024 / 1e6


def work(folder, starts):
    """Fit, and print what it took."""
    began, used = time.perf_counter(), time.process_time()
    study = gb.batch([gb.study.Member(pitch_hover.problem(), starts)], folder, progress=False)
    seconds, used = time.perf_counter() - began, time.process_time() - used
    (member,) = study.members
    assert read_members(study.folder)[0].runs >= starts
    stored = (study.folder / DATABASE).stat().st_size / 1e6
    print(
        f"{starts:7d} starts: {seconds:6.1f} s ({used:.1f} s of the processor), peak {peak():.0f} "
        f"MB, "
        f"study {stored:.2f} MB, {member.answer['agreeing']} agree",
        end="",
    )


def main():
    """Fit and compare in processes of their own."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--work", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work is not None:
        work(options.work, options.starts[0])
        return
    lines = [
        f"many_starts.py, greybox {version('greybox-id')}, {time.strftime('%Y-%m-%d')}, "
        f"{platform.machine()}"
    ]
    with tempfile.TemporaryDirectory() as place:
        for starts in options.starts:
            folder = Path(place) / str(starts)
            command = [sys.executable, __file__, "--work", folder, "--starts", str(starts)]
            said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            began, used = time.perf_counter(), os.times().children_user
            subprocess.run(
                [sys.executable, "-m", "greybox", "compare", folder],
                capture_output=True,
                check=True,
            )
            seconds, used = time.perf_counter() - began, os.times().children_user - used
            lines.append(f"{said}; greybox compare {seconds:.1f} s ({used:.1f} s of the processor)")
            print(lines[-1], flush=True)
    if options.out is not None:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
