"""How close the tests come to their limits, and which of them another processor would break.

    python benchmarks/assert_margins.py tests/statistics tests/engine/solve [--folder FOLDER]
    python benchmarks/assert_margins.py --folder FOLDER        compare what it holds, run nothing

Run the tests once for each of several machines and record, for every numerical comparison of an
assert (`a < limit`, `a == pytest.approx(b)`, `np.testing.assert_allclose`, `np.allclose`), how much
of its limit is used: 1 is the limit itself, 0.1 leaves a factor of ten. Machines are the matrix
kernels of OpenBLAS, forced by OPENBLAS_CORETYPE, the oldest with numpy without the vector
instructions that it found here; only a numpy that brings OpenBLAS shows a difference.

The table lists comparisons whose figure moves between machines by more than a hundredth and uses
more than a tenth of the limit, and those that ten times the move would break. A figure that is
rounding only needs a limit with a factor of ten in hand. A figure that has a meaning, such as a
standard error, must not move: mend what computes it. Tests take about twice their usual time.

The same file is the plugin of pytest that records, `-p assert_margins` with the name of the output
in GREYBOX_MARGINS. Tests are compiled with a call in place of every comparison in an assert.
"""

import argparse
import ast
import json
import operator
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any

OUTPUT = os.environ.get("GREYBOX_MARGINS")
ROOM = 0.1  # share of the limit beyond which a figure that moves is listed
MOVES = 0.01  # relative change of that share between machines: more than a figure with a meaning
RECORD = "_record_comparison"

# --- the plugin

if OUTPUT:
    import numpy as np
    import pytest

    OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
        "Lt": operator.lt,
        "LtE": operator.le,
        "Gt": operator.gt,
        "GtE": operator.ge,
        "Eq": operator.eq,
        "NotEq": operator.ne,
        "Is": operator.is_,
        "IsNot": operator.is_not,
        "In": lambda a, b: a in b,
        "NotIn": lambda a, b: a not in b,
    }
    APPROXIMATE = type(pytest.approx(1.0)).__mro__[-2]  # the base of all that approx returns
    TESTS = str(Path(__file__).parents[1] / "tests")
    largest: dict[str, dict[str, tuple[float, float, float]]] = {}
    current = ["collection"]

    class Recorded(ast.NodeTransformer):
        """Put a call in place of the comparisons of asserts."""

        inside = False

        def visit_Assert(self, node: ast.Assert) -> ast.Assert:
            """Change the condition, not the message."""
            self.inside = True
            node.test = self.visit(node.test)
            self.inside = False
            return node

        def visit_Compare(self, node: ast.Compare) -> ast.expr:
            """Return a call with the place, the operators and the sides."""
            self.generic_visit(node)
            if not self.inside:
                return node
            place = ast.Constant(f"{node.lineno}:{node.col_offset}")
            names = ast.Constant(" ".join(type(op).__name__ for op in node.ops))
            sides = [place, names, node.left, *node.comparators]
            call = ast.Call(ast.Name(RECORD, ast.Load()), sides, [])
            return ast.fix_missing_locations(ast.copy_location(call, node))

    def compared(place: str, operators: str, *sides: Any) -> Any:
        """Return the value of a chain of comparisons, recorded."""
        result: Any = True
        for name, left, right in zip(operators.split(), sides, sides[1:], strict=False):
            note(place, shares(name, left, right))
            result = OPERATORS[name](left, right)
            if len(sides) > 2 and not result:  # an array has no truth, but is in no chain
                return result
        return result

    def note(place: str, figures: Iterator[tuple[float, float, float]]) -> None:
        """Keep the largest share of the limit at a place in this test, with value and limit."""
        try:
            with np.errstate(all="ignore"):
                found = max(figures, default=None)
        except (TypeError, ValueError, OverflowError, AttributeError):
            return  # not numbers, or of shapes that do not go together
        if found is not None:
            places = largest.setdefault(current[0], {})
            places[place] = max(found, places.get(place, found))

    def shares(name: str, left: Any, right: Any) -> Iterator[tuple[float, float, float]]:
        """Yield the share of the limit that a comparison uses, its value and its limit."""
        if isinstance(left, APPROXIMATE) or isinstance(right, APPROXIMATE):
            value, wanted = (right, left) if isinstance(left, APPROXIMATE) else (left, right)
            yield from approximate(value, wanted, differs=name == "NotEq")
        elif name in ("Lt", "LtE", "Gt", "GtE"):
            low, high = (left, right) if name.startswith("Lt") else (right, left)
            pair = numbers(low), numbers(high)
            # Below a positive limit the share is low/high, below a negative one high/low.
            used = np.where(pair[1] > 0, np.maximum(pair[0], 0) / pair[1], pair[1] / pair[0])
            yield worst(used, *(pair if name.startswith("Lt") else pair[::-1]))

    def approximate(value: Any, wanted: Any, *, differs: bool) -> Iterator[tuple[float, ...]]:
        """Yield the share of the tolerance of approx, by its documented rule."""
        expected = wanted.expected
        if isinstance(expected, Mapping):
            pairs = [(value[key], one) for key, one in expected.items()]
            value, expected = zip(*pairs, strict=True) if pairs else ((), ())
        a, b = numbers(value), numbers(expected)
        absolute = 1e-12 if wanted.abs is None else float(wanted.abs)
        relative = 1e-6 if wanted.rel is None else float(wanted.rel)
        only = wanted.rel is None and wanted.abs is not None
        limit = np.maximum(0.0 if only else relative * np.abs(b), absolute)
        yield deviation(a, b, limit, differs=differs)

    def deviation(a: Any, b: Any, limit: Any, *, differs: bool = False) -> tuple[float, ...]:
        """Return the share of the limit that |a - b| uses."""
        moved = np.abs(a - b)
        used = np.where(moved > 0, limit / moved, np.inf) if differs else moved / limit
        return worst(np.where((a == b) & (not differs), 0.0, used), moved, limit)

    def numbers(values: Any) -> Any:
        """Return an array of real or complex numbers; no texts, no truths."""
        array = np.asarray(values)
        if array.dtype == object:
            array = np.array([0.0 if one is None else one for one in array.ravel()])
        if array.dtype.kind not in "iufc":
            raise TypeError(f"{array.dtype} is not a number")
        return array

    def worst(used: Any, value: Any, limit: Any) -> tuple[float, float, float]:
        """Return the largest share with its value and limit."""
        used, value, limit = np.broadcast_arrays(used, value, limit)
        if not np.isfinite(used).any():
            raise ValueError("no number")
        place = np.unravel_index(np.nanargmax(np.where(np.isfinite(used), used, -1)), used.shape)
        return float(used[place]), float(np.abs(value[place])), float(np.abs(limit[place]))

    def recorded_call(
        function: Callable[..., Any], share: Callable[..., Any]
    ) -> Callable[..., Any]:
        """Return a function of numpy that notes the share of its limit, by the calling line."""

        def call(*arguments: Any, **options: Any) -> Any:
            frame = sys._getframe(1)
            if frame.f_code.co_filename.startswith(TESTS):
                note(str(frame.f_lineno), iter_or_none(share, *arguments, **options))
            return function(*arguments, **options)

        return call

    def iter_or_none(share: Callable[..., Any], *arguments: Any, **options: Any) -> Iterator[Any]:
        """Yield a share, so that its errors appear where it is noted."""
        yield share(*arguments, **options)

    def by_tolerances(rtol: float, atol: float) -> Callable[..., Any]:
        """Return the share of the limit of numpy's functions, which have these defaults."""

        def share(a: Any, b: Any, rtol: float = rtol, atol: float = atol, **_: Any) -> Any:
            a, b = numbers(a), numbers(b)
            return deviation(a, b, atol + rtol * np.abs(b))

        return share

    np.testing.assert_allclose = recorded_call(np.testing.assert_allclose, by_tolerances(1e-7, 0))
    np.allclose = recorded_call(np.allclose, by_tolerances(1e-5, 1e-8))

    plain = SourceFileLoader.source_to_code

    def source_to_code(self: Any, data: Any, path: Any, **options: Any) -> Any:
        """Compile a test with its comparisons recorded, anything else as it is."""
        if str(path).startswith(TESTS) and Path(path).name.startswith("test_"):
            data = Recorded().visit(ast.parse(data, filename=path))
        return plain(self, data, path, **options)

    SourceFileLoader.source_to_code = source_to_code
    __builtins__[RECORD] = compared  # type: ignore[index]

    def pytest_runtest_logstart(nodeid: str) -> None:
        """Attribute what follows to this test."""
        current[0] = nodeid

    def pytest_sessionfinish() -> None:
        """Write what was recorded."""
        Path(str(OUTPUT)).write_text(json.dumps(largest), encoding="utf-8")


# --- the command


def machines() -> dict[str, dict[str, str]]:
    """Return the environment variables of every machine."""
    import numpy  # noqa: ICN001, PLC0415  (the plugin must set the environment before)

    vectors = numpy.show_config(mode="dicts")["SIMD Extensions"]["found"]
    kernels = ["Prescott", "Haswell"]
    if any(name.startswith(("AVX512", "X86_V4")) for name in vectors):
        kernels.append("SkylakeX")
    chosen = {kernel: {"OPENBLAS_CORETYPE": kernel} for kernel in kernels}
    # The oldest processor has neither.
    chosen["Prescott"]["NPY_DISABLE_CPU_FEATURES"] = " ".join(vectors)
    return chosen


def record(name: str, variables: dict[str, str], tests: list[str], folder: Path) -> None:
    """Run the tests on a machine, and keep its recording and what pytest printed."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {
            **os.environ,
            **variables,
            "OPENBLAS_NUM_THREADS": "1",
            "GREYBOX_MARGINS": str(folder / f"{name}.json"),
            "PYTHONPATH": str(Path(__file__).parent),
            # Neither may compiled tests be read without the calls, nor stay with them.
            "PYTHONPYCACHEPREFIX": cache,
        }
        command = [sys.executable, "-m", "pytest", "-p", "assert_margins", "-n", "0"]
        with open(folder / f"{name}.log", "w", encoding="utf-8") as log:
            subprocess.run(
                [*command, "--assert=plain", *tests], env=environment, stdout=log, check=False
            )
    print(name, (folder / f"{name}.log").read_text(encoding="utf-8").strip().splitlines()[-1])


def moved(folder: Path) -> list[str]:
    """Return the lines of the table, the tightest comparisons first."""
    recordings = {
        path.stem: json.loads(path.read_text(encoding="utf-8"))
        for path in sorted(folder.glob("*.json"))
    }
    places = {
        (test, place)
        for recording in recordings.values()
        for test, figures in recording.items()
        for place in figures
    }
    rows = []
    for test, place in sorted(places):
        figures = {
            name: recording[test][place]
            for name, recording in recordings.items()
            if place in recording.get(test, {})
        }
        used = [figure[0] for figure in figures.values()]
        high, change = max(used), max(used) - min(used)
        # Beyond its limit is what an assert counts, such as `np.mean(p < 0.05)`.
        is_loose = ROOM < high <= 1 and change > MOVES * high
        if is_loose or 10 * change > abs(1 - high):
            text = "  ".join(f"{name} {v:.3g} ({s:.2g})" for name, (s, v, _) in figures.items())
            limit = next(iter(figures.values()))[2]
            rows.append((high, f"{high:5.2f}  {test} line {place}, limit {limit:.3g}: {text}"))
    count = f"{len(places)} comparisons on {len(recordings)} machines; listed: {len(rows)}"
    return [count, *(line for _, line in sorted(rows, reverse=True))]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("tests", nargs="*")
    parser.add_argument("--folder", type=Path, help="where recordings are kept")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    folder = folder.resolve()
    if options.tests:
        for name, variables in machines().items():
            record(name, variables, options.tests, folder)
    print("\n".join(moved(folder)))


if __name__ == "__main__":
    main()
