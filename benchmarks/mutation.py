"""Plant faults in the package, one at a time, and see whether a test notices.

python benchmarks/mutation.py [--count 200] [--seed 1] [--files 'greybox/*'] [--jobs 1] [--cache DIR] [--budget 300]

Needs `coverage` (pip install -e '.[dev]'). Faults are a changed sign, operator, comparison or constant, a missing `abs`,
`max`, `min` or `clip`, and a missing error, warning or diagnosis; a seed is always the same sample of the same commit.
Against each run the tests that execute its line: those of the file that mirrors the module first, then the fastest, up
to the first failure. A run that takes far longer than its tests is an endless loop, and caught. A fault on a line that no
test executes has survived, and so has one that all tests within the budget (seconds of their own time) let through.

All happens in copies of the last commit in a temporary directory. Which test executes which line is measured once a
commit by a run of the whole suite, and kept in the cache.

Left out by rule: texts, type hints, decorators, `__all__`, and numbers in figures, which are looks. mutmut and cosmic-ray
were considered: the first replaces every function by a trampoline, which the modules that read a formula's source do not
survive, and knows the tests of a function but not of a line; the second runs one command for every fault, here five
minutes each. Neither draws a sample.
"""

import argparse
import ast
import copy
import fnmatch
import gc
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
from functools import _lru_cache_wrapper
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).resolve().parent
if __name__ == "__main__":
    sys.path.remove(str(HERE))  # its coverage.py is not the library

ROOT = HERE.parent
PATIENCE = 60, 8  # s, and times the tests' own time, after which a run counts as endless
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


# --- which faults there are ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Fault:
    """One change of one file: the source between two offsets is replaced."""

    file: str
    lines: range  # of the statement, or of its head: a test that executes one of them meets the fault
    line: int
    kind: str
    before: str
    after: str
    start: int  # offset into the encoded file
    end: int
    on_import: bool

    def __str__(self):
        return f"{self.file}:{self.line} {self.kind}: {self.before} -> {self.after}"


SWAPPED = {
    ast.Add: ("sign", ast.Sub),
    ast.Sub: ("sign", ast.Add),
    ast.Mult: ("operator", ast.Div),
    ast.Div: ("operator", ast.Mult),
    ast.Pow: ("operator", ast.Mult),
    ast.FloorDiv: ("operator", ast.Mult),
    ast.Mod: ("operator", ast.FloorDiv),
    ast.BitAnd: ("operator", ast.BitOr),
    ast.BitOr: ("operator", ast.BitAnd),
    ast.And: ("operator", ast.Or),
    ast.Or: ("operator", ast.And),
}
COMPARED = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
ABSOLUTE = {"abs", "fabs", "absolute"}
LIMITS = {"max", "min", "maximum", "minimum", "fmax", "fmin", "clip"}
TEXTS = (ast.JoinedStr, ast.List, ast.Tuple, ast.ListComp)


def faults_of(file: str, source: str):
    """Yield every place for a fault as a list of its variants."""
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def visit(node, statement, inside, returns):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            defaults = [] if isinstance(node, ast.ClassDef) else [*node.args.defaults, *node.args.kw_defaults]
            for default in filter(None, defaults):
                yield from visit(default, node, inside, returns)
            function = not isinstance(node, ast.ClassDef)
            result = ast.unparse(node.returns) if function and node.returns else ""
            for child in node.body:
                yield from visit(child, child, inside or function, result)
            return
        if isinstance(node, ast.stmt):
            statement = node
        variants = list(changes(node, file, returns))
        if variants:
            head = getattr(statement, "body", None)
            last = head[0].lineno - 1 if isinstance(head, list) else statement.end_lineno
            place = (starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset)
            lines = range(statement.lineno, max(last, statement.lineno) + 1)
            before = ast.unparse(node)
            yield [
                Fault(file, lines, node.lineno, kind, before, after, *place, not inside) for kind, after in variants
            ]
        for child in children(node):
            yield from visit(child, statement, inside, returns)

    yield from visit(ast.parse(source), None, False, "")


def children(node):
    """Yield the parts in which faults are planted."""
    if isinstance(node, (ast.JoinedStr, ast.Raise, ast.Import, ast.ImportFrom)):
        return
    if isinstance(node, ast.Call):
        name = called(node)
        if name in ("warn", "isinstance", "issubclass", "cast", "TypeVar", "ValueError", "OSError", "lru_cache"):
            return
        yield node.func
        yield from node.args
        yield from (k.value for k in node.keywords if k.arg != "strict")  # zip(strict=) is a check only
        return
    if isinstance(node, ast.AnnAssign):
        yield from filter(None, [node.value])
        return
    if isinstance(node, ast.Assign) and any(getattr(t, "id", "") == "__all__" for t in node.targets):
        return
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and isinstance(node.operand, ast.Constant):
        return
    yield from ast.iter_child_nodes(node)


def called(node) -> str:
    """Return the last name of what is called."""
    return getattr(node.func, "attr", getattr(node.func, "id", ""))


def is_text(node) -> bool:
    """Return whether an operand is a text or a list, of which + and * are no arithmetic."""
    return isinstance(node, TEXTS) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def changes(node, file, returns):
    """Yield the faults that one node can have, as kind and new source."""

    def with_(**parts):
        other = copy.copy(node)
        for name, value in parts.items():
            setattr(other, name, value)
        return f"({ast.unparse(other)})" if isinstance(other, ast.expr) else ast.unparse(other)

    looks = file.startswith("greybox/plotting/")
    if isinstance(node, ast.BinOp) and type(node.op) in SWAPPED and not (is_text(node.left) or is_text(node.right)):
        kind, other = SWAPPED[type(node.op)]
        yield kind, with_(op=other())
    elif isinstance(node, (ast.AugAssign, ast.BoolOp)) and type(node.op) in SWAPPED:
        if not (isinstance(node, ast.AugAssign) and is_text(node.value)):
            kind, other = SWAPPED[type(node.op)]
            yield kind, with_(op=other())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.Not)):
        yield "sign" if isinstance(node.op, ast.USub) else "operator", f"({ast.unparse(node.operand)})"
    elif isinstance(node, ast.Compare):
        for i, op in enumerate(node.ops):
            for other in COMPARED[type(op)]:
                yield "comparison", with_(ops=[*node.ops[:i], other(), *node.ops[i + 1 :]])
    elif isinstance(node, ast.Constant) and isinstance(node.value, (bool, int, float)) and not looks:
        yield "constant", repr(another(node.value))
    elif isinstance(node, ast.Call) and called(node) in ABSOLUTE and len(node.args) == 1:
        yield "abs", f"({ast.unparse(node.args[0])})"
    elif isinstance(node, ast.Call) and called(node) in LIMITS and len(node.args) >= 2:
        kept = next((a for a in node.args if not isinstance(a, (ast.Constant, ast.UnaryOp, ast.Starred))), None)
        if kept is not None:
            yield "limit", f"({ast.unparse(kept)})"
    else:
        yield from removals(node, returns)


def removals(node, returns):
    """Yield a statement that no longer says what is wrong."""
    if isinstance(node, ast.Raise) and "NotImplemented" not in ast.unparse(node):
        yield "removal", "pass"
    elif isinstance(node, ast.Return) and node.value is not None and "str" in returns and "None" in returns:
        if isinstance(node.value, ast.JoinedStr) or is_text(node.value):
            yield "removal", "return None"
    elif isinstance(node, ast.Expr):
        value = node.value
        if isinstance(value, ast.Yield) and isinstance(value.value, ast.JoinedStr):
            yield "removal", "yield from ()"
        elif isinstance(value, ast.Call):
            says = any(isinstance(a, ast.JoinedStr) for a in value.args)
            if called(value) == "warn" or (called(value) in ("append", "add") and says):
                yield "removal", "pass"


def another(number):
    """Return a number as a slip would leave it: one off, twice as large, or a tolerance with another exponent."""
    if isinstance(number, (bool,)):
        return not number
    if isinstance(number, int):
        return number + 1 if number < 1000 else 2 * number
    if number == 0:
        return 1.0
    return number * (1000 if abs(number) < 1e-5 else 2)


def sample(root: Path, pattern: str, count: int, seed: int) -> list[Fault]:
    """Draw faults, each place equally likely, at most one a place."""
    names = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [f for f in sorted(names.split()) if fnmatch.fnmatch(f, pattern) and not f.startswith("tests/")]
    places = [p for f in files for p in faults_of(f, (root / f).read_text())]
    draw = random.Random(seed)
    return [draw.choice(place) for place in draw.sample(places, min(count, len(places)))]


# --- which tests execute a line: this file is a plugin of pytest too ------------------------------------------------

NOTES = os.environ.get("GREYBOX_MUTATION_NOTES")  # the folder for what a measuring run writes down
ORDER = os.environ.get("GREYBOX_MUTATION_ORDER")  # the file with the tests to run, in their order


if NOTES:
    import pytest

    _caches: list = []

    def _fixtures(item):
        """Return the names of the fixtures that this test shares with others."""
        found = getattr(item, "_fixtureinfo", None)
        defined = [d for ds in (found.name2fixturedefs.values() if found else ()) for d in ds]
        return [f"fixture {d.baseid}::{d.argname}" for d in defined if d.scope != "function"]

    def _note(**what):
        with open(f"{NOTES}/{os.getpid()}.jsonl", "a") as file:
            file.write(json.dumps(what) + "\n")

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(item, nextitem):
        """Attribute what is executed to this test, which finds every cache empty."""
        import coverage

        if not _caches or _caches[0] != item.path:
            wrapped = (o for o in gc.get_objects() if isinstance(o, _lru_cache_wrapper))
            own = ("greybox", "test_", "nist")
            _caches[:] = [item.path, *(o for o in wrapped if (o.__module__ or "").rpartition("tests.")[2].startswith(own))]
        for cache in _caches[1:]:
            cache.cache_clear()
        coverage.Coverage.current().switch_context(item.nodeid)
        _note(test=item.nodeid, fixtures=_fixtures(item))
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(fixturedef, request):
        """Attribute a fixture of many tests to itself."""
        import coverage

        measured = coverage.Coverage.current()
        if fixturedef.scope == "function" or measured is None:
            return (yield)
        measured.switch_context(f"fixture {fixturedef.baseid}::{fixturedef.argname}")
        try:
            return (yield)
        finally:
            measured.switch_context(os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" ")[0])

    def pytest_runtest_logreport(report):
        """Keep how long it took and how it ended."""
        _note(test=report.nodeid, seconds=report.duration, outcome=report.outcome)


if ORDER:

    def pytest_collection_modifyitems(config, items):
        """Keep the tests that execute the line, in the order chosen for them."""
        order = {name: i for i, name in enumerate(Path(ORDER).read_text().splitlines())}
        items[:] = sorted((i for i in items if i.nodeid in order), key=lambda i: order[i.nodeid])


def git(*arguments) -> str:
    """Return what git answers about this checkout."""
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def checkout(folder: Path) -> Path:
    """Put the last commit into a folder."""
    folder.mkdir(parents=True)
    archive = subprocess.Popen(["git", "archive", "HEAD"], cwd=ROOT, stdout=subprocess.PIPE)
    subprocess.run(["tar", "x", "-C", str(folder)], stdin=archive.stdout, check=True)
    # Compiled files that are checked by content: two versions of one file within a second would share their time stamp.
    compiling = ["-m", "compileall", "-q", "--invalidation-mode", "checked-hash", "greybox", "models", "problems"]
    subprocess.run([sys.executable, *compiling], cwd=folder, check=True)
    return folder


def command_of_tests(*arguments):
    """Return the command that runs tests with this file as plugin."""
    plugins = ["greybox_mutation", "no:cacheprovider", "no:benchmark"]  # the last one warns of parallel tests
    return [sys.executable, "-m", "pytest", *(word for p in plugins for word in ("-p", p)), *arguments]


def environment(copy_: Path, plugin: Path, **more) -> dict:
    """Return the environment in which every process imports the copy."""
    plugin.mkdir(exist_ok=True)
    (plugin / "greybox_mutation.py").write_text(Path(__file__).read_text())
    return {**os.environ, "PYTHONPATH": f"{plugin}:{copy_}", "OMP_NUM_THREADS": "1", **more}


def measure(cache: Path, jobs: int) -> None:
    """Run the whole suite and keep which test executes which line."""
    import coverage

    with tempfile.TemporaryDirectory() as work_:
        work = Path(work_)
        copy_, notes, plugin = checkout(work / "copy"), work / "notes", work / "plugin"
        notes.mkdir()
        rules = work / "coveragerc"
        rules.write_text(MEASURING.format(folder=work, copy=copy_))
        env = environment(
            copy_, plugin, GREYBOX_MUTATION_NOTES=str(notes), COVERAGE_PROCESS_START=str(rules), COVERAGE_CORE="ctrace"
        )
        (plugin / "sitecustomize.py").write_text(LOADING)
        done = subprocess.run(command_of_tests("-n", str(jobs)), cwd=copy_, env=env, stdout=sys.stderr, check=False)
        if done.returncode > 1:  # some tests may fail, and are not used then
            sys.exit("The tests did not run.")

        tests: dict = {}
        for note in (json.loads(line) for f in notes.glob("*.jsonl") for line in f.read_text().splitlines()):
            test = tests.setdefault(note["test"], {"seconds": 0.0, "passed": True, "fixtures": []})
            test["fixtures"] = note.get("fixtures", test["fixtures"])
            test["seconds"] = round(test["seconds"] + note.get("seconds", 0), 4)
            test["passed"] &= note.get("outcome", "passed") == "passed"

        combined = coverage.Coverage(data_file=str(work / "data"), config_file=str(rules))
        combined.combine([str(f) for f in work.glob("data.*")])
        data = combined.get_data()
        lines = {
            str(Path(f).relative_to(copy_)): {str(k): v for k, v in data.contexts_by_lineno(f).items()}
            for f in data.measured_files()
        }
    cache.parent.mkdir(parents=True, exist_ok=True)
    cache.write_text(json.dumps({"tests": tests, "lines": lines}))


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
            test = context.rpartition(" (")[0] if context.endswith(")") and " (" in context else context
            found.update(self.sharing.get(context, [test] if test in self.tests else ()))
        return found

    def against(self, fault: Fault, root: Path) -> list:
        """Return the tests that meet a fault, those of the mirroring file first, then the fastest."""
        tests = self.executing(fault.file, fault.lines)
        if fault.on_import:  # executed before any test: what is computed with it, here and where it is imported
            name = fault.file[: -len(".py")].replace("/", ".")
            users = [f for f in self.lines if name in (root / f).read_text()]
            for file in (fault.file, *users):
                tests |= self.executing(file, function_lines((root / file).read_text()))
        files: dict = {}
        for test in tests:
            files.setdefault(test.partition("::")[0], []).append(test)
        mirror = fault.file.replace("greybox/", "tests/", 1).replace(Path(fault.file).name, f"test_{Path(fault.file).name}")

        def seconds(test):
            return self.tests[test]["seconds"]

        order = sorted(files, key=lambda f: (f != mirror, sum(map(seconds, files[f]))))
        return [test for file in order for test in sorted(files[file], key=seconds)]


def function_lines(source: str) -> set:
    """Return the lines in the bodies of functions."""
    functions = (n for n in ast.walk(ast.parse(source)) if isinstance(n, (ast.FunctionDef, ast.AsyncFunctionDef)))
    return {line for f in functions for line in range(f.body[0].lineno, f.end_lineno + 1)}


# --- one fault after the other --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """What the tests said of a fault."""

    fault: Fault
    caught: bool
    how: str
    seconds: float


def tried(fault: Fault, tests: list, seconds: dict, copy_: Path, budget: float) -> Outcome:
    """Run the tests against one fault, in a copy that is left as it was."""
    began = time.monotonic()
    if not tests:
        return Outcome(fault, False, "no test executes it", 0.0)
    chosen, total = [], 0.0
    for test in tests:
        if chosen and total + seconds[test] > budget:
            break
        chosen.append(test)
        total += seconds[test]
    said = "all" if len(chosen) == len(tests) else "the first"
    path, order = copy_ / fault.file, copy_ / "mutation_order"
    sound = path.read_bytes()
    order.write_text("\n".join(chosen))
    path.write_bytes(sound[: fault.start] + fault.after.encode() + sound[fault.end :])
    try:
        env = environment(copy_, copy_.parent / f"plugin_{copy_.name}", GREYBOX_MUTATION_ORDER=str(order))
        files = dict.fromkeys(t.partition("::")[0] for t in chosen)
        command = command_of_tests("-n", "0", "-x", "--tb=line", *files)
        process = subprocess.Popen(
            command, cwd=copy_, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
        )
        try:
            output, _ = process.communicate(timeout=PATIENCE[0] + PATIENCE[1] * total)
        except subprocess.TimeoutExpired:
            output = None
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    finally:
        path.write_bytes(sound)
    took = time.monotonic() - began
    if output is None:
        return Outcome(fault, True, "endless", took)
    if process.returncode == 0:
        return Outcome(fault, False, f"{said} {len(chosen)} of {len(tests)} tests passed", took)
    if process.returncode == 5:
        raise SystemExit(f"No test was collected for {fault}:\n{output}")
    failed = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return Outcome(fault, True, failed[0] if failed else f"exit status {process.returncode}", took)


def main() -> None:
    """Measure once, then plant and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=200, help="number of faults")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--files", default="greybox/*", help="pattern of the files that get faults")
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time")
    parser.add_argument("--cache", type=Path, default=Path.home() / ".cache" / "greybox-mutation")
    parser.add_argument("--budget", type=float, default=300.0, help="seconds of tests against one fault")
    parser.add_argument("--list", action="store_true", help="print the sample and stop")
    options = parser.parse_args()
    if git("status", "--porcelain", "--untracked-files=no"):
        sys.exit("The checkout has changes: commit them first, since the last commit is what is measured.")
    commit = git("rev-parse", "HEAD")
    faults = sample(ROOT, options.files, options.count, options.seed)
    if options.list:
        print(*faults, sep="\n")
        return

    cache = options.cache / f"{commit}.json"
    if not cache.exists():
        print(f"Running all tests, to see which executes what; kept in {cache}", file=sys.stderr)
        measure(cache, options.jobs)
    known = Map(json.loads(cache.read_text()))
    seconds = {name: test["seconds"] for name, test in known.tests.items()}

    with tempfile.TemporaryDirectory() as work, ThreadPoolExecutor(options.jobs) as pool:
        free = [checkout(Path(work) / f"copy{i}") for i in range(options.jobs)]

        def run(numbered):
            number, fault = numbered
            copy_ = free.pop()
            try:
                outcome = tried(fault, known.against(fault, ROOT), seconds, copy_, options.budget)
            finally:
                free.append(copy_)
            word = "caught" if outcome.caught else "SURVIVED"
            print(f"{number:4} {word:8} {outcome.seconds:5.0f} s  {fault}  [{outcome.how}]", file=sys.stderr, flush=True)
            return outcome

        began = time.monotonic()
        outcomes = list(pool.map(run, enumerate(faults)))
    print_summary(outcomes, options, commit, time.monotonic() - began)


def print_summary(outcomes, options, commit, took) -> None:
    """Print the share of each kind, and every fault that survived with its line."""
    print(f"{date.today()}, greybox-id {version('greybox-id')}, python {platform.python_version()}, commit {commit[:7]}")
    caught = sum(o.caught for o in outcomes)
    print(f"{len(outcomes)} faults, seed {options.seed}, {options.files}, {took:.0f} s: {caught} caught", end="")
    print(f" ({100 * caught / len(outcomes):.1f} %), {sum(o.how == 'endless' for o in outcomes)} of them as endless loops")
    kinds = Counter(o.fault.kind for o in outcomes)
    for kind, number in kinds.most_common():
        print(f"{kind:12}{sum(o.caught for o in outcomes if o.fault.kind == kind):4} of {number}")
    for outcome in (o for o in outcomes if not o.caught):
        fault = outcome.fault
        print(f"\n{fault}  ({outcome.how})")
        print(f"    {(ROOT / fault.file).read_text().splitlines()[fault.line - 1].strip()}")


if __name__ == "__main__":
    main()
