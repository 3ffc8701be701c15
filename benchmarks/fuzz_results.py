"""Load damaged or crafted fits, sealed again, and crafted HDF5 logs, as a stranger could send them.

python benchmarks/fuzz_results.py [--count 2000] [--seed 0] [--only 4711] [--keep FILE]

Every file is loaded and printed in a process of its own, forked from one that has imported greybox.
A sound outcome is a fit or a log that prints, or a ValueError that names the file, within 2 s and
500 MB: processor time of the process and of the one that it starts (clock time would measure what
else the machine does; what waits is ended after 20 s), and the sum of their peak memories. Number N
of a seed is always the same file. A file that names a module must not have it imported; one that
names another file must not show its contents; none may print what a terminal obeys.
"""

import argparse
import importlib
import os
import platform
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from datetime import date
from importlib.metadata import version
from pathlib import Path

import numpy as np

import greybox as gb
from greybox.data.files.sealed_files import BLOCK

ROOT = Path(__file__).parents[1]
SECONDS, MEMORY = 2.0, 500e6  # for one file; bytes
PATIENCE = 20  # s after which a process is ended
TOKENS = [b"null", b"-1", b"1e999", b"NaN", b"0.5", b'"a"', b"[]", b"{}", b"9" * 5000]


def sound(path: Path) -> None:
    """Save a fit of a response and a record, with a few starts."""
    omega = np.geomspace(1, 20, 12)
    lag = importlib.import_module("greybox.models.polynomial").Polynomial(1, 0)
    response = gb.FrequencyResponse(
        omega, 2 / (1j * omega + 3) * (1 + 0.01 * np.sin(omega)), input="u", output="y"
    )
    time_ = 0.05 * np.arange(100)
    u, y = np.sin(2 * time_), np.zeros(100)
    for k in range(99):
        y[k + 1] = y[k] + 0.05 * (2 * u[k] - 3 * y[k])
    record = gb.Record(time_, {"u": u, "y": y + 0.01 * np.cos(50 * time_)}, name="record")
    problem = gb.Problem(lag, response, gb.RelativeLikelihood()) + gb.Problem(lag, record)
    gb.save(gb.fit(problem, starts=3, progress=False), path)


def mutated(rng: np.random.Generator, raw: bytes) -> bytes:
    """Return a file with one to three damages after the block with the seal."""
    data = bytearray(raw)
    for _ in range(rng.integers(1, 4)):
        data = DAMAGES[rng.integers(len(DAMAGES))](rng, data)
    return bytes(data)


def _place(rng, data):
    """Return where to damage: anywhere, or near the start, where the file describes itself."""
    end = len(data) if rng.random() < 0.6 else min(len(data), BLOCK + 4096)
    return int(rng.integers(BLOCK, max(end, BLOCK + 1)))


def _flip(rng, data):
    for _ in range(2 ** rng.integers(0, 5)):
        data[min(_place(rng, data), len(data) - 1)] ^= 1 << int(rng.integers(8))
    return data


def _overwrite(rng, data):
    at, length = _place(rng, data), int(2 ** rng.integers(0, 7))
    data[at : at + length] = rng.bytes(length)
    return data


def _number(rng, data):
    at = _place(rng, data)
    token = TOKENS[rng.integers(len(TOKENS))]
    data[at : at + int(rng.integers(len(token) + 1))] = token
    return data


def _swap(rng, data):
    length = int(2 ** rng.integers(3, 13))
    a, b = _place(rng, data), _place(rng, data)
    length = max(0, min(length, abs(a - b), len(data) - max(a, b)))
    data[a : a + length], data[b : b + length] = data[b : b + length], data[a : a + length]
    return data


def _truncate(rng, data):
    return data[: max(BLOCK + 1, int(rng.integers(BLOCK, len(data))))]


def _append(rng, data):
    return data + rng.bytes(int(2 ** rng.integers(0, 13)))


def _describe(rng, data):
    """Put another value of the same length into the JSON, which mostly stays JSON."""
    marks = [b": ", b", ", b'"numbers": [', b'"shape": [']
    mark = marks[rng.integers(len(marks))]
    start = data.find(mark, _place(rng, data))
    if start >= 0:
        at = start + len(mark)
        end = data.find(b",", at)
        token = TOKENS[rng.integers(len(TOKENS))]
        if end - at >= len(token):
            data[at:end] = token.ljust(end - at)
    return data


DAMAGES = (
    _flip,
    _flip,
    _overwrite,
    _number,
    _number,
    _swap,
    _truncate,
    _append,
    _describe,
    _describe,
)


def outcome(path: Path, is_log: bool = False) -> tuple[str, str, float, float]:
    """Return in a word what became of a file, the details, s of processor time, and bytes."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(reader)
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            signal.alarm(PATIENCE)
            os.chdir(path.parent)
            os.write(writer, _loaded(path, is_log).encode("utf-8", "replace")[:4000])
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        said = pipe.read().decode("utf-8", "replace")
    _, status, used = os.wait4(child, 0)
    seconds = used.ru_utime + used.ru_stime
    word, _, rest = said.partition("|")
    memory, _, details = rest.partition("|")
    if not said:
        word, details = "KILLED", f"signal {os.WTERMSIG(status)}"
    size = float(memory or 0)
    if (path.parent / "EXECUTED").exists():
        return "EXECUTED", details, seconds, size
    if word.islower() and (seconds > SECONDS or size > MEMORY):
        return "OVER THE LIMIT", f"{seconds:.2f} s, {size / 1e6:.0f} MB, {details}", seconds, size
    return word, details, seconds, size


def _loaded(path: Path, is_log: bool) -> str:
    """Load and print a file in this process.

    Return what became of it, peak memory in bytes, details.
    """
    word, details = outcome_of(path, is_log)
    # Linux counts in kB. What a process starts inherits the peak of its parent until it has more of
    # its own.
    peaks = [
        resource.getrusage(who).ru_maxrss
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    ]
    return f"{word}|{1024 * sum(peaks)}|{details}"


def outcome_of(path: Path, is_log: bool = False) -> tuple[str, str]:
    try:
        answer = gb.read(path) if is_log else gb.load(path)
    except ValueError as error:
        text = str(error)
        return (
            ("refused", text)
            if str(path) in text and text.isprintable()
            else ("NO SENTENCE", repr(text)[:300])
        )
    except BaseException as error:
        return "RAW EXCEPTION", f"{type(error).__name__}: {error}"[:300]
    if isinstance(answer, gb.Fit):
        return _used(answer)
    # The file beside it has ones and zeros times a million.
    shown = any(np.any(x == 1e6) for record in answer.values() for x in record.signals.values())
    return ("SHOWS ANOTHER FILE", f"{answer}") if shown else ("read", "")


def _used(fit: gb.Fit) -> tuple[str, str]:
    """Print and evaluate a fit that was loaded."""
    try:
        text = f"{fit}{fit!r}{fit.parts!r}{fit.quantities!r}{fit.interval()}"
        np.asarray(fit.covariance).sum()
    except BaseException as error:
        return "DOES NOT PRINT", f"{type(error).__name__}: {error}"[:300]
    if not all(line.isprintable() for line in text.replace("\t", " ").split("\n")):
        return "CONTROL CHARACTERS", repr(text)[:300]
    if "nobody was to see" in text:
        return "SHOWS ANOTHER FILE", text[:300]
    try:
        if fit.responses:
            fit.response([1.0, 2.0])
    except (LookupError, ValueError):
        pass
    except BaseException as error:
        return "RAW EXCEPTION", f"response, {type(error).__name__}: {error}"[:300]
    return "read", ""


def fuzz(numbers: range, names: list[str], seed: int = 0, keep: Path | None = None):
    """Try the numbered mutants and the crafted files.

    Return counts, failures, and (s, bytes, which) of all.
    """
    sys.path.insert(0, str(ROOT / "tests" / "support"))
    crafted, sealing = map(importlib.import_module, ("crafted_results", "sealing"))
    counts, failures, costs = Counter(), [], []

    def note(kind, which, path):
        word, details, seconds, size = outcome(path, which in crafted.CRAFTED_LOGS)
        counts[kind, word] += 1
        costs.append((seconds, size, which))
        if word.isupper():
            failures.append((which, word, details))
        path.unlink()

    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "sound.h5"
        sound(whole)
        raw = whole.read_bytes()
        os.mkfifo(Path(folder) / "pipe")
        for number in numbers:
            path = Path(folder) / "damaged.h5"
            path.write_bytes(mutated(np.random.default_rng((seed, number)), raw))
            sealing.seal(path)
            if keep:
                keep.write_bytes(path.read_bytes())
            note("mutants", f"number {number}", path)
        for name in names or [*crafted.CRAFTED, *crafted.CRAFTED_LOGS]:
            path = Path(folder) / "crafted.h5"
            crafted.craft(name, whole, path)
            note("crafted", name, path)
    return counts, failures, costs


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="load this mutant alone")
    parser.add_argument(
        "--crafted", nargs="+", default=[], help="of the crafted files, these alone"
    )
    parser.add_argument("--keep", type=Path, help="write the mutant to this file")
    options = parser.parse_args()
    numbers = (
        range(options.count) if options.only is None else range(options.only, options.only + 1)
    )
    began = time.perf_counter()
    counts, failures, costs = fuzz(numbers, options.crafted, options.seed, options.keep)
    versions = ", ".join(f"{name} {version(name)}" for name in ("greybox-id", "h5py", "numpy"))
    print(f"{date.today()}, {versions}, python {platform.python_version()}")
    seconds = time.perf_counter() - began
    print(
        f"{len(numbers)} mutants, seed {options.seed}, {len(costs) - len(numbers)} crafted files, "
        f"{seconds:.0f} s"
    )
    for kind, word in sorted(counts):
        print(f"{kind:10} {word:20} {counts[kind, word]:6}")
    for which, what, unit, scale in ((0, "slowest", "s", 1), (1, "largest", "MB", 1e-6)):
        top = sorted(costs, key=lambda cost: -cost[which])[:5]
        print(
            f"{what}: " + ", ".join(f"{cost[which] * scale:.3g} {unit} ({cost[2]})" for cost in top)
        )
    print(
        f"median: {np.median([c[0] for c in costs]):.2f} s, "
        f"{np.median([c[1] for c in costs]) / 1e6:.0f} MB"
    )
    for which, word, details in failures:
        print(f"{which}: {word}: {details}")
    if not failures:
        print(
            f"none over {SECONDS:g} s or {MEMORY / 1e6:g} MB, no crash, no raw exception, nothing "
            f"executed or shown"
        )
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
