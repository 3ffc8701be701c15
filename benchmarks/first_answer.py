"""Where the processor time of a first answer goes, in a fresh process.

python benchmarks/first_answer.py [--repeats 5] [--output FILE] [PROBLEM ...]

`greybox fit PROBLEM` as a user types it: the interpreter, imports (at any depth, in any place), and
all the rest: reading the data, compiling, searching, judging, printing.
"""

import argparse
import os
import subprocess
import sys
from statistics import median

# In the child: the outermost import is timed, those within it are a part of it.
CHILD = """
import atexit, builtins, runpy, sys, time
began, original, state = time.process_time(), builtins.__import__, {"depth": 0, "imports": 0.0}

def timed(*arguments, **options):
    if state["depth"]:
        return original(*arguments, **options)
    state["depth"], before = 1, time.process_time()
    try:
        return original(*arguments, **options)
    finally:
        state["depth"] = 0
        state["imports"] += time.process_time() - before

def report():
    total = time.process_time()
    print(began, state["imports"], total - began - state["imports"], file=sys.stderr)

builtins.__import__ = timed
atexit.register(report)
sys.argv = ["greybox", "fit", sys.argv[1]]
runpy.run_module("greybox", run_name="__main__")
"""


def seconds(problem: str) -> tuple[float, float, float]:
    """Return the processor time of the interpreter, of imports, and of the rest, s."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", CHILD, problem]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    interpreter, imports, rest = map(float, run.stderr.split()[-3:])
    return interpreter, imports, rest


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("problems", nargs="*", default=["pitch_hover", "rotors", "sitl_drag"])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--output", type=argparse.FileType("w"), default=sys.stdout)
    options = parser.parse_args()

    lines = [f"{'processor time, s':<20}{'interpreter':>12}{'imports':>10}{'the rest':>10}"]
    for problem in options.problems:
        runs = [seconds(problem) for _ in range(options.repeats)]
        interpreter, imports, rest = map(median, zip(*runs, strict=True))
        lines.append(f"{problem:<20}{interpreter:>12.3f}{imports:>10.3f}{rest:>10.3f}")
    print("\n".join(lines), file=options.output)


if __name__ == "__main__":
    main()
