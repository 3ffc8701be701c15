"""Plant faults in copies of the package, and see how long `tests/differential` takes to notice.

python benchmarks/planted_faults.py [--seconds 120] [--seed 1] [--only FAULT] [--out FILE]

Each fault is a few lines at the end of a file of a copy: they replace one function by a broken one,
or call it in the wrong way, so the rest of the file may change. The command then makes new cases in
the copy. A case counts only if it agrees in the package as it is. The exit status is 1 if a fault
was not seen in time, or could not be planted because its function has another name now.
"""

import argparse
import os
import platform
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from datetime import date
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("greybox", "models", "problems", "tests/differential")
REPEATED = re.compile(r"\[--only (\S+) --case (\d+)\]$")


@dataclass(frozen=True)
class Fault:
    """The line by which the file of a fault is recognized, and what is added at its end."""

    name: str
    anchor: str
    code: str


FAULTS = (
    Fault(
        "calls of CasADi functions are read as zero",
        "def with_finite_slopes(",
        """
_right = with_finite_slopes
def with_finite_slopes(formula):
    symbols = ca.symvar(formula)
    def calls(entry):
        return bool(ca.Function("entry", symbols, [entry]).find_functions(0))
    entries = ca.vertsplit(ca.densify(_right(formula)))
    return ca.vertcat(*[ca.SX(0) if calls(entry) else entry for entry in entries])
""",
    ),
    Fault(
        # A worker that lacks something costs time alone: its runs are made again at home.
        "a worker weighs its data twice",
        "class Part(",
        """
_right_state = Part.__getstate__
Part.__getstate__ = lambda self: _right_state(self) | {"weight": 2 * self.weight}
""",
    ),
    Fault(
        "a listed start is lost",
        "class Listed(",
        """
_right_draw = Listed.draw
def _draw(self, parameters):
    points = _right_draw(self, parameters)
    points[:] = [parameter.start for parameter in parameters.values()]
    return points
Listed.draw = _draw
""",
    ),
    Fault(
        "known initial states are forgotten",
        "class OutputError(",
        """
_right_init = OutputError.__post_init__
def _post_init(self):
    _right_init(self)
    vars(self)["initial"] = {}
OutputError.__post_init__ = _post_init
""",
    ),
    Fault(
        "held inputs run in lines",
        "def intersample(",
        """
_right = intersample
def intersample(hold, step):
    return Intersample(False, 0.0)
""",
    ),
    Fault(
        "measured outputs are swapped",
        "def gapless(",
        """
_right = gapless
def gapless(record, inputs, outputs, **options):
    return _right(record, inputs, outputs[::-1], **options)
""",
    ),
    Fault(
        "a long step restarts the model",
        "def gapless(",
        """
_right = gapless
def gapless(record, inputs, outputs, **options):
    steps = np.diff(record.time)
    cuts = [0, *(np.flatnonzero(steps > 1.5 * np.median(steps)) + 1).tolist(), len(record)]
    if not record.has_time or len(cuts) == 2:
        return _right(record, inputs, outputs, **options)
    stretches = []
    for first, end in zip(cuts[:-1], cuts[1:]):
        if end - first >= 3:
            piece = record.between(record.time[first], record.time[end - 1])
            stretches += [
                replace(stretch, rows=stretch.rows + first)
                for stretch in _right(piece, inputs, outputs, **options)
            ]
    return stretches
""",
    ),
    Fault(
        "decibels of power in place of those of amplitude",
        "class MagnitudePhase(",
        """
_DB_PER_NEPER = 10 / math.log(10)
""",
    ),
    Fault(
        "priors are dropped",
        "def with_priors(",
        """
def with_priors(problem):
    return problem
""",
    ),
    Fault(
        "a tied parameter keeps its start",
        "class Problem(",
        """
_right_values = Problem.local_values
def _local_values(self, values):
    model, formulas = self.model, self.tied
    starts = {name: model.parameters[name].start for name in formulas}
    vars(self)["tied"] = {name: lambda _, start=start: start for name, start in starts.items()}
    try:
        return _right_values(self, values)
    finally:
        vars(self)["tied"] = formulas
Problem.local_values = _local_values
""",
    ),
    Fault(
        "ties of one part serve the others",
        "class Problem(",
        """
_right_values = Problem.local_values
_formulas = {}
def _local_values(self, values):
    formulas = self.tied
    first = {name: _formulas.setdefault((self.model, name), tie) for name, tie in formulas.items()}
    vars(self)["tied"] = first
    try:
        return _right_values(self, values)
    finally:
        vars(self)["tied"] = formulas
Problem.local_values = _local_values
""",
    ),
    Fault(
        "delays are half a sample too long",
        "def input_over_step(",
        """
_right = input_over_step
def input_over_step(window, fraction, held):
    is_free = getattr(fraction, "is_constant", lambda: True)() is False
    return _right(window, fraction + 0.5 if is_free else fraction, held)
""",
    ),
    Fault(
        "missing outputs count as zero",
        "def gapless(",
        """
_right = gapless
def gapless(record, inputs, outputs, **options):
    stretches = _right(record, inputs, outputs, **options)
    return [replace(s, outputs=np.nan_to_num(s.outputs)) for s in stretches]
""",
    ),
)


def planted(fault: Fault, folder: Path) -> bool:
    """Copy the package with a fault, and return whether there is a place for it."""
    for name in COPIED:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    starts = re.compile(rf"^{re.escape(fault.anchor)}", re.MULTILINE)
    files = [f for f in (folder / "greybox").rglob("*.py") if starts.search(f.read_text("utf-8"))]
    if len(files) != 1:
        return False
    with files[0].open("a", encoding="utf-8") as file:
        file.write(fault.code)
    return True


def command(root: Path, *options: object) -> tuple[list[str], dict[str, str]]:
    """Return the command of random cases for the package in `root`, and its environment."""
    words = [sys.executable, str(root / "tests/differential"), *map(str, options)]
    return words, os.environ | {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}


def agrees_without(family: str, case: str) -> bool:
    """Return whether a case agrees in the package as it is."""
    words, environment = command(ROOT, "--only", family, "--case", case)
    return subprocess.run(words, env=environment, capture_output=True, check=False).returncode == 0


def first_difference(fault: Fault, seed: int, seconds: float) -> str:
    """Return the first case that sees a fault and the time until then, or why there is none."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        if not planted(fault, folder):
            return f"NOT PLANTED: no single file has a line that begins with {fault.anchor!r}"
        # A busy machine takes longer, and is not to change what is seen: the clock has no say.
        words, environment = command(
            folder, "--seed", seed, "--seconds", 100 * seconds, "--without-open"
        )
        also = 0
        with subprocess.Popen(
            words,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        ) as process:
            assert process.stdout is not None
            resource.prlimit(process.pid, resource.RLIMIT_CPU, (round(seconds), round(seconds)))
            for line in process.stdout:
                repeated = REPEATED.search(line.strip())
                if repeated and agrees_without(*repeated.groups()):
                    process.kill()
                    used = os.wait4(process.pid, 0)[2]
                    process.returncode = -signal.SIGKILL  # it has been waited for
                    took = used.ru_utime + used.ru_stime
                    return f"seen after {took:.0f} s: {line.strip()[:150]}"
                also += 1
    return f"NOT SEEN in {seconds:.0f} s ({also} cases differ without the fault, too)"


def main() -> int:
    """Plant every fault; return 1 if one is not seen."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", help="a part of the name of a fault")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lines = [
        f"planted_faults.py, {date.today()}, Python {platform.python_version()}, "
        f"{options.seconds:.0f} s a fault, seed {options.seed}"
    ]
    print(lines[0])
    for fault in FAULTS:
        if options.only is None or options.only in fault.name:
            found = first_difference(fault, options.seed, options.seconds)
            lines.append(f"{fault.name}: {found}")
            print(lines[-1], flush=True)
    if options.out is not None:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 1 if any(": NOT " in line for line in lines) else 0


if __name__ == "__main__":
    sys.exit(main())
