"""Plant faults in the package, one at a time, and see whether a test notices.

python benchmarks/mutation.py [--count 200] [--seed 1] [--files 'greybox/*'] [--jobs 1]
    [--cache DIR] [--budget 300]
    [--minutes 60] [--anew] [--list]

Needs `coverage`, which comes with the `dev` extra. Faults are a changed sign, operator, comparison
or constant, a missing `abs`, `max`, `min` or `clip`, and a missing error, warning or diagnosis; a
seed is always the same sample of the same commit. Against each run the tests that execute its line:
those of the file that mirrors the module first, then the fastest files, up to the first failure, of
a test that passes without the fault. A run that takes far longer than its tests is an endless loop,
and caught. A fault on a line that no test executes has survived, and so has one that all tests
within the budget let through. All faults meet a tenth of the budget before one of them meets the
rest of it. Times of tests and their limits are processor time, so other work on the machine changes
how long a sample takes and not what it says; only `--minutes` is time of the clock. The measuring
run takes some twenty minutes of one processor and 1 GB; a fault that is caught takes 5 s, of which
half are imports, and one that survives up to its budget.

All happens in copies of the last commit in a temporary directory. Which test executes which line is
measured once by a run of the whole suite, and kept in the cache. Where it holds that of an earlier
commit, only tests that are newer run: lines of the package keep their tests, and new lines have
those of the line above. Tests can be missed in this way, and faults then count as survivors;
`--anew` runs the whole suite again.

Left out by rule: texts, type hints, decorators, `__all__`, and numbers in figures, which are looks.
mutmut and cosmic-ray were considered: the first replaces every function by a trampoline, and knows
which tests reach a function but not a line; the second runs one command for every fault, which is
the whole suite. Neither draws a sample.
"""

import argparse
import ast
import fnmatch
import json
import os
import platform
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import date
from difflib import SequenceMatcher
from importlib.metadata import version
from itertools import accumulate, repeat
from pathlib import Path

from mutation_faults import Fault, faults_of

HERE = Path(__file__).resolve().parent
sys.path[:] = [
    p for p in sys.path if Path(p or ".").resolve() != HERE
]  # its coverage.py would hide the library

from coverage import Coverage  # noqa: E402

ROOT = HERE.parent
MEASURED = ("greybox", "models", "problems")
# Seconds, and times the tests' own, of processor time after which a run counts as endless. One that
# waits for what never comes uses none: it counts as endless after so many times as long by the
# clock.
PATIENCE = 60, 8
WAITING = 20
LOADING = "import coverage\ncoverage.process_startup()\n"
MEASURING = """[run]
parallel = true
data_file = {folder}/data
context = ${{PYTEST_CURRENT_TEST-}}
include =
    {copy}/greybox/*
    {copy}/models/*
    {copy}/problems/*
"""


def sample(root: Path, pattern: str, count: int, seed: int) -> list[Fault]:
    """Draw faults, each place equally likely, at most one per place."""
    names = subprocess.run(
        ["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    files = [
        f
        for f in sorted(names.split())
        if fnmatch.fnmatch(f, pattern) and not f.startswith("tests/")
    ]
    places = [p for f in files for p in faults_of(f, (root / f).read_text())]
    draw = random.Random(seed)
    return [draw.choice(place) for place in draw.sample(places, min(count, len(places)))]


def git(*arguments) -> str:
    """Return the answer of git about this checkout."""
    return subprocess.run(
        ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()


def checkout(folder: Path) -> Path:
    """Put the last commit into a folder."""
    folder.mkdir(parents=True)
    archive = subprocess.Popen(["git", "archive", "HEAD"], cwd=ROOT, stdout=subprocess.PIPE)
    subprocess.run(["tar", "x", "-C", str(folder)], stdin=archive.stdout, check=True)
    # Compiled files that are checked by content: two versions of one file within a second would
    # share their time stamp.
    compiling = [
        "-m",
        "compileall",
        "-q",
        "--invalidation-mode",
        "checked-hash",
        "greybox",
        "models",
        "problems",
    ]
    subprocess.run([sys.executable, *compiling], cwd=folder, check=True)
    return folder


def command_of_tests(*arguments):
    """Return the command that runs tests with this file as plugin."""
    plugins = [
        "mutation_plugin",
        "no:cacheprovider",
        "no:benchmark",
    ]  # the last one warns of parallel tests
    return [
        sys.executable,
        "-m",
        "pytest",
        *(word for p in plugins for word in ("-p", p)),
        *arguments,
    ]


def environment(copy_: Path, plugin: Path, **more) -> dict:
    """Return the environment in which every process imports the copy."""
    plugin.mkdir(exist_ok=True)
    for name in ("mutation_plugin.py", "mutation_server.py"):
        (plugin / name).write_text((HERE / name).read_text())
    return {**os.environ, "PYTHONPATH": f"{plugin}:{copy_}", "OMP_NUM_THREADS": "1", **more}


def known_map(folder: Path, jobs: int, *, anew: bool) -> "Map":
    """Return which test executes which line of the last commit.

    Of an earlier map, only tests that are newer run.
    """
    target = folder / f"{git('rev-parse', 'HEAD')}.json"
    if anew or not target.exists():
        folder.mkdir(parents=True, exist_ok=True)
        earlier = (
            c for c in git("rev-list", "-100", "HEAD").split() if (folder / f"{c}.json").exists()
        )
        base = None if anew else next(earlier, None)
        if base:
            newer = git(
                "diff", "--name-only", "--no-renames", base, "HEAD", "--", *MEASURED, "tests"
            ).split()
            tests = [
                f for f in newer if f.startswith("tests/") and Path(f).name.startswith("test_")
            ]
            old = json.loads((folder / f"{base}.json").read_text())
            known = carried(old, base, [f for f in newer if f not in tests])
            stored = merged(
                known, measure(jobs, [f for f in tests if (ROOT / f).exists()]), tuple(tests)
            )
        else:
            stored = measure(jobs)
        target.write_text(json.dumps(stored))
    return Map(json.loads(target.read_text()))


def carried(known: dict, base: str, files: list) -> dict:
    """Move what is known of the lines of these files from an earlier commit to the last one."""
    lines = dict(known["lines"])
    for file in files:
        old = lines.pop(file, None)
        if old is None or not (ROOT / file).exists():
            continue
        before, after = (
            git("show", f"{base}:{file}").splitlines(),
            git("show", f"HEAD:{file}").splitlines(),
        )
        same = SequenceMatcher(None, before, after, autojunk=False).get_matching_blocks()
        numbers = {b + k + 1: a + k + 1 for a, b, size in same for k in range(size)}
        moved, above = {}, []
        for number in range(1, len(after) + 1):
            tests = old.get(str(numbers[number])) if number in numbers else above
            if tests:
                moved[str(number)] = above = tests
        lines[file] = moved
    return {**known, "lines": lines}


def merged(old: dict, new: dict, files: tuple) -> dict:
    """Replace what is known of some test files."""

    def is_old(context):
        return not context.removeprefix("fixture ").startswith(tuple(f"{f}::" for f in files))

    tests = {name: test for name, test in old["tests"].items() if is_old(name)} | new["tests"]
    lines: dict = {}
    for file in {*old["lines"], *new["lines"]}:
        before, after = old["lines"].get(file, {}), new["lines"].get(file, {})
        lines[file] = {
            n: [*filter(is_old, before.get(n, ())), *after.get(n, ())] for n in {*before, *after}
        }
    return {"tests": tests, "lines": lines}


def measure(jobs: int, files: list | None = None) -> dict:
    """Run the whole suite, or some files of it, and return which test executes which line."""
    print(
        f"Running {'all' if files is None else 'newer'} tests, to see which executes what.",
        file=sys.stderr,
    )
    if files == []:
        return {"tests": {}, "lines": {}}
    with tempfile.TemporaryDirectory() as work_:
        work = Path(work_)
        copy_, notes, plugin = checkout(work / "copy"), work / "notes", work / "plugin"
        notes.mkdir()
        rules = work / "coveragerc"
        rules.write_text(MEASURING.format(folder=work, copy=copy_))
        env = environment(
            copy_,
            plugin,
            GREYBOX_MUTATION_NOTES=str(notes),
            COVERAGE_PROCESS_START=str(rules),
            COVERAGE_CORE="ctrace",
        )
        (plugin / "sitecustomize.py").write_text(LOADING)
        command = command_of_tests("-n", str(jobs), *(files or ()))
        done = subprocess.run(command, cwd=copy_, env=env, stdout=sys.stderr, check=False)
        if done.returncode > 1:  # some tests may fail, and are not used then
            sys.exit("The tests did not run.")

        tests: dict = {}
        for note in (
            json.loads(line) for f in notes.glob("*.jsonl") for line in f.read_text().splitlines()
        ):
            test = tests.setdefault(note["test"], {"seconds": 0.0, "passed": True, "fixtures": []})
            test["fixtures"] = note.get("fixtures", test["fixtures"])
            test["seconds"] = round(test["seconds"] + note.get("seconds", 0), 4)
            test["passed"] &= note.get("outcome", "passed") == "passed"

        combined = Coverage(data_file=str(work / "data"), config_file=str(rules))
        combined.combine([str(f) for f in work.glob("data.*")])
        data = combined.get_data()
        lines = {
            str(Path(f).relative_to(copy_)): {
                str(k): v for k, v in data.contexts_by_lineno(f).items()
            }
            for f in data.measured_files()
        }
    return {"tests": tests, "lines": lines}


class Map:
    """Which tests execute which line of this commit."""

    def __init__(self, stored: dict):
        self.tests = {k: v for k, v in stored["tests"].items() if v["passed"]}
        self.lines = stored["lines"]
        self.sharing: dict = {}
        for name, test in self.tests.items():
            for fixture in test["fixtures"]:
                self.sharing.setdefault(fixture, []).append(name)

    def executing(self, file: str, lines) -> set:
        """Return the tests that execute one of these lines."""
        found = set()
        for context in {c for n in lines for c in self.lines.get(file, {}).get(str(n), ())}:
            test = (
                context.rpartition(" (")[0]
                if context.endswith(")") and " (" in context
                else context
            )
            found.update(self.sharing.get(context, [test] if test in self.tests else ()))
        return found

    def against(self, fault: Fault, root: Path) -> list:
        """Return the tests that meet a fault: those of the mirroring file, then the fastest."""
        tests = self.executing(fault.file, fault.lines)
        if (
            fault.on_import
        ):  # executed before any test: what is computed with it, here and where it is imported
            name = fault.file[: -len(".py")].replace("/", ".")
            users = [f for f in self.lines if name in (root / f).read_text()]
            for file in (fault.file, *users):
                tests |= self.executing(file, function_lines((root / file).read_text()))
        files: dict = {}
        for test in tests:
            files.setdefault(file_of(test), []).append(test)
        mirror = f"test_{Path(fault.file).name}"  # in the same folder, or in that above it

        def seconds(test):
            return self.tests[test]["seconds"]

        order = sorted(files, key=lambda f: (Path(f).name != mirror, sum(map(seconds, files[f]))))
        return [test for file in order for test in sorted(files[file], key=seconds)]


def function_lines(source: str) -> set:
    """Return the lines in the bodies of functions."""
    functions = (
        n
        for n in ast.walk(ast.parse(source))
        if isinstance(n, (ast.FunctionDef, ast.AsyncFunctionDef))
    )
    return {line for f in functions for line in range(f.body[0].lineno, f.end_lineno + 1)}


# --- one fault after the other


class Copy:
    """A copy of the package, in which tests run against a fault."""

    def __init__(self, folder: Path, seconds: dict):
        self.root, self.seconds = checkout(folder), seconds
        self.order, self.output = (
            folder.parent / f"{folder.name}_order",
            folder.parent / f"{folder.name}_output",
        )
        env = environment(folder, folder.parent / f"{folder.name}_plugin")
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self.server = subprocess.Popen(
            [sys.executable, "-m", "mutation_server"], cwd=folder, env=env, **pipes
        )

    def run(self, tests: list, fault: Fault | None = None) -> tuple[str, str]:
        """Return what failed, or nothing, and what was said of it.

        All files are left as they were.
        """
        failed = Path(f"{self.order}.failed")
        for file in (failed, self.output):
            file.unlink(missing_ok=True)
        self.order.write_text("\n".join(tests))
        limit = round(PATIENCE[0] + PATIENCE[1] * sum(self.seconds[t] for t in tests))
        request = {
            "order": str(self.order),
            "output": str(self.output),
            "limit": limit,
            "waiting": WAITING * limit,
        }
        path = self.root / (fault.file if fault else "pyproject.toml")
        sound = path.read_bytes()
        if fault:
            path.write_bytes(sound[: fault.start] + fault.after.encode() + sound[fault.end :])
        try:
            print(json.dumps(request), file=self.server.stdin, flush=True)
            status = json.loads(self.server.stdout.readline())
        finally:
            path.write_bytes(sound)
        if status in (None, -signal.SIGXCPU, -signal.SIGKILL):
            return "endless", "endless"
        if status in (0, 5):  # 5 is that no test was found
            return "", ""
        said = [
            line
            for line in self.output.read_text().splitlines()
            if line.startswith(("FAILED", "ERROR"))
        ]
        where = failed.read_text() if failed.exists() else f"exit status {status}"
        return where, said[0] if said else f"exit status {status}"


@dataclass(frozen=True)
class Outcome:
    """The verdict of the tests on a fault."""

    fault: Fault
    caught: bool
    how: str
    seconds: float
    passed: int = 0  # tests


def file_of(test: str) -> str:
    """Return the file of a test."""
    return test.partition("::")[0]


def parts_of(tests: list):
    """Yield tests of one file, of the two files after it, of four, ....

    Few files are imported for nothing.
    """
    files: dict = {}
    for test in tests:
        files.setdefault(file_of(test), []).append(test)
    groups, size = list(files.values()), 1
    while groups:
        yield [test for group in groups[:size] for test in group]
        groups, size = groups[size:], 2 * size


def tried(before: Outcome, tests: list, copy_: Copy, budget: float, sound: dict) -> Outcome:
    """Run those tests against a fault that it has not met.

    `sound` holds whether those that failed pass without it.
    """
    began, fault = time.monotonic() - before.seconds, before.fault
    tests = [t for t in tests if sound.get(t, True) and sound.get(file_of(t), True)]
    if not tests:
        return Outcome(fault, False, "no test executes it", 0.0)
    totals = list(accumulate(copy_.seconds[t] for t in tests))
    last = max(1, sum(total <= budget for total in totals))
    waiting = list(parts_of(tests[before.passed : last]))
    while waiting:
        part = waiting.pop(0)
        failed, said = copy_.run(part, fault)
        suspects = [t for t in part if failed in (t, file_of(t))]
        if suspects and failed not in sound:
            sound[failed] = not copy_.run(suspects)[0]
        if failed and sound.get(failed, True):
            return Outcome(fault, True, said, time.monotonic() - began)
        if failed:
            waiting.insert(0, [t for t in part if t not in suspects])
    how = f"{'all' if last == len(tests) else 'the first'} {last} of {len(tests)} tests passed"
    failing = sum(not (sound.get(t, True) and sound.get(file_of(t), True)) for t in tests)
    how += f", {failing} of them fail without it too" if failing else ""
    return Outcome(fault, False, how, time.monotonic() - began, last)


def main() -> None:
    """Measure once, then plant and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=200, help="number of faults")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--files", default="greybox/*", help="pattern of the files that get faults")
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time")
    parser.add_argument("--cache", type=Path, default=Path.home() / ".cache" / "greybox-mutation")
    parser.add_argument(
        "--budget", type=float, default=300.0, help="s of processor time of tests against a fault"
    )
    parser.add_argument(
        "--minutes", type=float, default=float("inf"), help="after which no other fault is planted"
    )
    parser.add_argument(
        "--anew", action="store_true", help="see again which test executes what, in all tests"
    )
    parser.add_argument("--list", action="store_true", help="print the sample and stop")
    options = parser.parse_args()
    if git("status", "--porcelain", "--untracked-files=no"):
        sys.exit(
            "The checkout has changes: commit them first, since the last commit is what is "
            "measured."
        )
    faults = sample(ROOT, options.files, options.count, options.seed)
    if options.list:
        print(*faults, sep="\n")
        return

    known = known_map(options.cache, options.jobs, anew=options.anew)
    seconds = {name: test["seconds"] for name, test in known.tests.items()}

    with tempfile.TemporaryDirectory() as work, ThreadPoolExecutor(options.jobs) as pool:
        free = [Copy(Path(work) / f"copy{i}", seconds) for i in range(options.jobs)]
        sound: dict = {}
        began = time.monotonic()

        def run(numbered, budget):
            number, before = numbered
            if time.monotonic() - began > 60 * options.minutes:
                return before
            copy_ = free.pop()
            try:
                outcome = tried(before, known.against(before.fault, ROOT), copy_, budget, sound)
            finally:
                free.append(copy_)
            word = "caught" if outcome.caught else "SURVIVED"
            line = f"{number:4} {word:8} {outcome.seconds:5.0f} s  {outcome.fault}  [{outcome.how}]"
            print(line, file=sys.stderr, flush=True)
            return outcome

        outcomes = dict(enumerate(Outcome(fault, False, "", 0.0) for fault in faults))
        for budget in (options.budget / 10, options.budget):
            left = [
                (i, o) for i, o in outcomes.items() if not o.how or o.how.startswith("the first")
            ]
            outcomes |= zip((i for i, _ in left), pool.map(run, left, repeat(budget)), strict=True)
        for copy_ in free:
            copy_.server.stdin.close()
    print_summary([o for o in outcomes.values() if o.how], options, time.monotonic() - began)


def print_summary(outcomes, options, took) -> None:
    """Print the share of each kind, and every fault that survived with its line."""
    print(f"{date.today()}, greybox-id {version('greybox-id')}, python {platform.python_version()}")
    caught, endless = sum(o.caught for o in outcomes), sum(o.how == "endless" for o in outcomes)
    of = f" of {options.count} (the time was over)" if len(outcomes) < options.count else ""
    print(
        f"{len(outcomes)} faults{of}, seed {options.seed}, {options.files}, {took:.0f} s:", end=" "
    )
    print(
        f"{caught} caught ({100 * caught / len(outcomes):.1f} %), {endless} of them as endless "
        f"loops"
    )
    kinds = Counter(o.fault.kind for o in outcomes)
    for kind, number in kinds.most_common():
        print(f"{kind:12}{sum(o.caught for o in outcomes if o.fault.kind == kind):4} of {number}")
    for outcome in (o for o in outcomes if not o.caught):
        fault = outcome.fault
        print(f"\n{fault}  ({outcome.how})")
        print(f"    {(ROOT / fault.file).read_text().splitlines()[fault.line - 1].strip()}")


if __name__ == "__main__":
    main()
