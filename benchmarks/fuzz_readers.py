"""Feed the readers with damaged files.

None may hang, crash the process, print, or raise anything but a sentence.

python benchmarks/fuzz_readers.py [--count 20000] [--seed 0] [--entry read|inspect]
    [--only 4711] [--kinds bin tlog] [--unguarded]

All inputs go through one process, each with a time limit. They are sound files of every format (up
to 200 kB) after one to four mutations; number N of a seed is always the same input, so that
``--only N`` reproduces it, and ``--keep FILE`` writes it. A sound outcome is a recording, or a
ValueError or OSError of one line (for the command line: exit status 0, 1 or 2). If the process
dies, the file named by ``--progress`` says at which number.

``--unguarded`` shows what the subprocess of HDF5 and MATLAB files is for. Each file is read in a
fork of this process instead, and counted by how the fork ends: by a signal, such as SIGXCPU after
5 s of processor time, or with more than 600 MB of memory. Linux only.
"""

import argparse
import contextlib
import faulthandler
import importlib
import io
import os
import platform
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import NoReturn

import numpy as np

import greybox.data.logs.readers

ROOT = Path(__file__).parents[1]
LARGEST = 200_000  # bytes
LIMIT = 20  # s for one input
QUICK = [
    ".bin",
    ".csv",
    ".log",
    ".tlog",
]  # read in this process, thousands a minute; the others start one of their own
NUMBERS = [
    b"\x00" * 4,
    b"\xff" * 4,
    b"\x00\x00\x00\x80",
    b"\xff\xff\xff\x7f",
    b"\x01\x00\x00\x00",
    b"\x00\x00\x01\x00",
]


class Hang(BaseException):
    """Raised by the alarm; no `except Exception` on the way can swallow it."""


def seeds() -> dict[str, list[bytes]]:
    """Return sound files by suffix."""
    sys.path.insert(0, str(ROOT / "tests" / "support"))
    made = importlib.import_module("synthetic_logs")
    return {suffix: [data[:LARGEST] for data in files] for suffix, files in made.samples().items()}


def mutated(
    rng: np.random.Generator, files: dict[str, list[bytes]], kinds: list[str]
) -> tuple[str, bytes]:
    """Return a suffix and a damaged file."""
    suffix = kinds[rng.integers(len(kinds))]
    data = bytearray(files[suffix][rng.integers(len(files[suffix]))])
    other = files[kinds[rng.integers(len(kinds))]][0]
    for _ in range(rng.integers(1, 5)):
        data = MUTATIONS[rng.integers(len(MUTATIONS))](rng, data, other)
        if not data:
            break
    if rng.random() < 0.05:
        suffix = rng.choice([".bin", ".log", ".tlog", ".csv", ".h5", ".mat", ".ulg", ".xyz", ""])
    return suffix, bytes(data[:LARGEST])


def _flip(rng, data, _):
    for at in rng.integers(len(data), size=2 ** rng.integers(0, 8)):
        data[at] ^= 1 << int(rng.integers(8))
    return data


def _overwrite(rng, data, _):
    at, length = int(rng.integers(len(data))), int(2 ** rng.integers(0, 9))
    data[at : at + length] = rng.bytes(length)
    return data


def _truncate(rng, data, _):
    return data[: rng.integers(len(data))]


def _remove(rng, data, _):
    at = int(rng.integers(len(data)))
    del data[at : at + int(2 ** rng.integers(0, 14))]
    return data


def _repeat(rng, data, _):
    """Insert a chunk of the file elsewhere, once or many times.

    Repeated descriptions, torn messages.
    """
    at, to, length = (
        int(rng.integers(len(data))),
        int(rng.integers(len(data))),
        int(2 ** rng.integers(2, 12)),
    )
    data[to:to] = data[at : at + length] * int(rng.choice([1, 1, 2, 20]))
    return data


def _insert(rng, data, other):
    """Insert bytes that are random, all alike, or of another file."""
    at, length = int(rng.integers(len(data))), int(2 ** rng.integers(0, 13))
    data[at:at] = [rng.bytes(length), bytes([int(rng.integers(256))]) * length, other[:length]][
        rng.integers(3)
    ]
    return data


def _number(rng, data, _):
    """Write an extreme number: lengths, counts and offsets live among them."""
    at = int(rng.integers(min(len(data), 4096) if rng.random() < 0.5 else len(data)))
    number = NUMBERS[rng.integers(len(NUMBERS))] * int(rng.integers(1, 3))
    data[at : at + len(number)] = number
    return data


def _header(rng, data, _):
    """Damage a byte near the start, where most formats describe themselves."""
    data[int(rng.integers(min(len(data), 512)))] = int(rng.integers(256))
    return data


def _describe(rng, data, _):
    """Damage the bytes after a marker.

    A DataFlash description, a packet's head, an object header of HDF5.
    """
    marks = [
        b"\xa3\x95\x80",
        b"\xa3\x95",
        b"\xfd",
        b"\xfe",
        b"FMT,",
        b"TREE",
        b"SNOD",
        b"HEAP",
        b"OHDR",
        b"\n",
    ]
    mark = marks[rng.integers(len(marks))]
    start = data.find(mark, int(rng.integers(len(data))))
    if start >= 0:
        at = start + len(mark) + int(rng.integers(8))
        data[at : at + 1] = bytes([int(rng.choice([0, 1, 2, 3, 127, 128, 255, rng.integers(256)]))])
    return data


MUTATIONS = (
    _flip,
    _flip,
    _overwrite,
    _truncate,
    _remove,
    _repeat,
    _insert,
    _number,
    _number,
    _header,
    _describe,
    _describe,
)


def outcome(entry: Callable[[str], object], path: str, limit: float) -> tuple[str, str]:
    """Return what became of one file, in a word, and the details."""
    heard = io.StringIO()
    signal.signal(signal.SIGALRM, _alarm)
    signal.setitimer(signal.ITIMER_REAL, limit)
    try:
        with (
            contextlib.redirect_stdout(heard),
            contextlib.redirect_stderr(heard),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("error")
            status = entry(path)
    except Hang:
        return "HANG", f"more than {limit:g} s"
    except SystemExit as end:
        status = end.code
    except (ValueError, OSError) as refused:
        said = str(refused)
        plain = (
            type(refused).__module__ == "builtins"
            and "\n" not in said
            and said.rstrip().endswith(".")
        )
        return (
            ("refused", said)
            if plain
            else ("NO SENTENCE", f"{type(refused).__name__}: {said[:200]!r}")
        )
    except BaseException as problem:  # the whole point: whatever it is, it must not come through
        return "RAW EXCEPTION", f"{type(problem).__name__}: {str(problem)[:200]!r}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    if "Traceback" in heard.getvalue():
        return "TRACEBACK", heard.getvalue()[-200:]
    if not isinstance(status, int | None):
        return ("PRINTED", heard.getvalue()[:200]) if heard.getvalue() else ("read", "")
    return (
        ("read", "")
        if status in (0, None)
        else (f"status {status}", "")
        if status in (1, 2)
        else ("STATUS", str(status))
    )


def _alarm(*_):
    raise Hang


def fuzz(
    entry: Callable[[str], object],
    numbers: range,
    seed: int = 0,
    limit: float = LIMIT,
    kinds: list[str] | None = None,
    progress: Path | None = None,
    keep: Path | None = None,
) -> tuple[Counter, list[tuple[int, str, str, str]], list[tuple[float, int, str]]]:
    """Run the numbered inputs; return counts by (suffix, outcome), what failed, and the slowest."""
    files = seeds()
    kinds = [f".{kind.lstrip('.')}" for kind in kinds] if kinds else [*sorted(files), *2 * QUICK]
    counts, failures, slow = Counter(), [], []
    with tempfile.TemporaryDirectory() as folder:
        for number in numbers:
            suffix, data = mutated(np.random.default_rng((seed, number)), files, kinds)
            path = keep or Path(folder) / f"damaged{suffix}"
            path.write_bytes(data)
            if progress:
                progress.write_text(f"{number} {suffix}\n")
            faulthandler.dump_traceback_later(
                3 * limit, exit=True
            )  # a hang inside C, which no alarm can interrupt
            began = time.perf_counter()
            result, details = outcome(entry, str(path), limit)
            seconds = time.perf_counter() - began
            faulthandler.cancel_dump_traceback_later()
            counts[suffix, result] += 1
            slow = sorted([*slow, (seconds, number, suffix)], reverse=True)[:5]
            if result.isupper():
                failures.append((number, suffix, result, details))
            if not keep:
                path.unlink()
    return counts, failures, slow


ENDS = ("read", "refused", "memory")  # by the exit status of a fork


def unguarded(numbers: range, seed: int) -> Counter:
    """Read damaged HDF5 and MATLAB files in forks, without the limits; count how these end."""
    files, counts = seeds(), Counter()
    named_arrays = importlib.import_module("greybox.data.logs.readers.named_arrays")
    named_arrays.read_in_subprocess = importlib.import_module("read_here").read_here
    for name in ("h5py", "scipy.io"):
        importlib.import_module(name)  # once, not in every fork
    with tempfile.TemporaryDirectory() as folder:
        for number in numbers:
            suffix, data = mutated(np.random.default_rng((seed, number)), files, [".h5", ".mat"])
            path = Path(folder) / f"damaged{suffix}"
            path.write_bytes(data)
            fork = os.fork()
            if not fork:
                _read_and_exit(str(path))
            status = os.waitpid(fork, 0)[1]
            is_killed = os.WIFSIGNALED(status)
            end = signal.Signals(os.WTERMSIG(status)).name if is_killed else None
            counts[suffix, end or ENDS[os.WEXITSTATUS(status)]] += 1
            path.unlink()
    return counts


def _read_and_exit(path: str) -> NoReturn:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (5, 6))
    resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    end = "read"
    try:
        greybox.data.logs.readers.read(path)
    except MemoryError:
        end = "memory"
    except BaseException:  # whatever the libraries raise
        end = "refused"
    if resource.getrusage(resource.RUSAGE_SELF).ru_maxrss > 600_000:  # kB
        end = "memory"
    os._exit(ENDS.index(end))


def inspect(path: str) -> object:
    """Run the command line's entry point."""
    return importlib.import_module("greybox.cli.main").main(["inspect", path])


def report(counts: Counter, failures: list, slow: list) -> None:
    outcomes = sorted({result for _, result in counts}, key=lambda r: (r != "read", r.isupper(), r))
    print("suffix".ljust(8) + "".join(word.rjust(16) for word in outcomes))
    for suffix in sorted({suffix for suffix, _ in counts}):
        print(
            (suffix or "none").ljust(8)
            + "".join(str(counts[suffix, word]).rjust(16) for word in outcomes)
        )
    print(
        "all".ljust(8)
        + "".join(str(sum(n for (_, r), n in counts.items() if r == w)).rjust(16) for w in outcomes)
    )
    print(
        "slowest: "
        + ", ".join(
            f"{seconds:.2f} s (number {number}, {suffix})" for seconds, number, suffix in slow
        )
    )
    for number, suffix, result, details in failures:
        print(f"number {number} ({suffix}): {result}: {details}")
    if not failures:
        print("no hang, no crash, no raw exception, nothing printed")


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--entry", choices=("read", "inspect"), default="read")
    parser.add_argument("--only", type=int, help="run this number alone")
    parser.add_argument("--keep", type=Path, help="write the input to this file, with --only")
    parser.add_argument("--kinds", nargs="+", help="suffixes of the sound files to start from")
    parser.add_argument("--limit", type=float, default=LIMIT, help="s for one input")
    parser.add_argument("--progress", type=Path, help="file that names the input under way")
    parser.add_argument("--unguarded", action="store_true", help="HDF5 and MATLAB, in forks")
    options = parser.parse_args()
    entry = greybox.data.logs.readers.read if options.entry == "read" else inspect
    numbers = (
        range(options.count) if options.only is None else range(options.only, options.only + 1)
    )
    began = time.perf_counter()
    if options.unguarded:
        found = (unguarded(numbers, options.seed), [], [])
    else:
        found = fuzz(
            entry,
            numbers,
            options.seed,
            options.limit,
            options.kinds,
            options.progress,
            options.keep,
        )
    versions = ", ".join(
        f"{name} {version(name)}" for name in ("greybox-id", "pymavlink", "h5py", "scipy", "numpy")
    )
    print(f"{date.today()}, {versions}, python {platform.python_version()}")
    seconds = time.perf_counter() - began
    print(
        f"{len(numbers)} inputs, seed {options.seed}, through {options.entry}, {seconds:.0f} s, "
        f"{LARGEST} bytes at most"
    )
    if options.unguarded:
        print(
            "\n".join(
                f"{n:6}  {kind or 'none'} {end}" for (kind, end), n in sorted(found[0].items())
            )
        )
        return
    report(*found)
    sys.exit(1 if found[1] else 0)


if __name__ == "__main__":
    os.environ.setdefault("MPLBACKEND", "agg")
    main()
