"""Time and memory of `gb.read` for a DataFlash log, against pymavlink on the same messages.

python benchmarks/read_speed.py [LOG.BIN] [--messages ATT RATE] [--megabytes 20] [--rounds 5]

Without a file it makes one: attitude and rates at 400 Hz, two IMUs at 100 Hz, GPS at 5 Hz. Every
round measures both, one after the other, so that the ratio does not depend on how busy the machine
is; pymavlink is timed from opening the file to the last `recv_match`, no field being looked at.
Peak memory is that of a fresh process, less what it has after importing (VmHWM of Linux; the pages
of the file count).
"""

import argparse
import contextlib
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from datetime import date
from importlib.metadata import version
from pathlib import Path

import numpy as np
from pymavlink.DFReader import DFReader_binary

import greybox.data.logs.readers

MEMORY = """
import sys
import greybox.data.logs.readers.dataflash as dataflash
def peak():
    lines = open("/proc/self/status")
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))
before = peak()
recording = dataflash.read(sys.argv[1], sys.argv[2:] or None)
kept = sum(record.time.nbytes * (1 + len(record.signals)) for record in recording.values())
print(peak() - before, kept)
"""


def synthetic(path: Path, megabytes: float) -> None:
    """Write a log of about that size."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
    from synthetic_logs import Log  # noqa: PLC0415 (needed for this alone)

    log = Log()
    log.fmt(
        "ATT",
        "QccccCCCCB",
        "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF",
        "sddddhhdh-",
        "FBBBBBBBB-",
    )
    log.fmt(
        "RATE",
        "Qffffffffffff",
        "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut,ADes,A,AOut",
        "skk-kk-kk-oo-",
        "F?????????BB-",
    )
    log.fmt(
        "IMU",
        "QBffffffIIfBBHH",
        "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz",
        "s#",
        "F-",
    )
    log.fmt(
        "GPS",
        "QBBIHBcLLeffffB",
        "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U",
        "s#",
        "F-",
    )
    header, log.parts, log.lines = log.binary, [], []
    for i in range(400):  # one second, repeated with other times
        at = 2500 * i
        log.add("ATT", at, 0.0, 0.5, 1.25, 0.9, 90.0, 91.0, 0.01, 0.02, 3)
        log.add("RATE", at + 100, *[0.1 * k for k in range(12)])
        if i % 4 == 0:
            for lane in (0, 1):
                log.add(
                    "IMU",
                    at + 200,
                    lane,
                    *[0.1 * k for k in range(6)],
                    0,
                    0,
                    35.0,
                    1,
                    1,
                    1000,
                    1000,
                )
        if i % 80 == 0:
            log.add(
                "GPS",
                at + 300,
                0,
                3,
                1000,
                2200,
                12,
                0.8,
                -35.36,
                149.16,
                584.0,
                1.0,
                90.0,
                0.0,
                0.0,
                1,
            )
    second = np.frombuffer(log.binary, dtype=np.uint8).copy()
    stamps = np.cumsum([0] + [len(part) for part in log.parts[:-1]]) + 3
    ticks = np.array([int.from_bytes(part[3:11], "little") for part in log.parts])
    with open(path, "wb") as file:
        file.write(header)
        for number in range(round(megabytes * 1e6 / len(second))):
            moved = (ticks + 1_000_000 * (number + 10)).astype("<u8").view(np.uint8).reshape(-1, 8)
            second[stamps[:, None] + np.arange(8)] = moved
            file.write(second.tobytes())


def ours(path: Path, messages: list[str] | None) -> float:
    """Read with greybox; s."""
    began = time.perf_counter()
    greybox.data.logs.readers.read(path, messages)
    return time.perf_counter() - began


def theirs(path: Path, messages: list[str] | None) -> float:
    """Iterate with pymavlink; s."""
    with (
        open(os.devnull, "w") as nowhere,
        contextlib.redirect_stdout(nowhere),
        contextlib.redirect_stderr(nowhere),
    ):
        began = time.perf_counter()
        log = DFReader_binary(str(path))
        while log.recv_match(type=messages) is not None:
            pass
        seconds = time.perf_counter() - began
        log.close()
    return seconds


def memory(path: Path, messages: list[str] | None) -> tuple[float, float]:
    """Peak memory of a reading, and the size of the arrays kept; bytes."""
    command = [sys.executable, "-c", MEMORY, str(path), *(messages or [])]
    peak, kept = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    return float(peak), float(kept)


def measure(path: Path, messages: list[str] | None, rounds: int) -> None:
    pairs = [(ours(path, messages), theirs(path, messages)) for _ in range(rounds)]
    mine, other = (statistics.median(column) for column in zip(*pairs, strict=True))
    ratio = statistics.median(a / b for a, b in pairs)
    peak, kept = memory(path, messages)
    print(
        f"{', '.join(messages or ['everything']):<12} {mine:7.3f} s  pymavlink {other:7.3f} s  "
        f"ratio {ratio:6.3f}"
        f"   peak {peak / 1e6:6.1f} MB for {kept / 1e6:6.1f} MB of arrays: {peak / kept:.1f} times"
    )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path, nargs="?")
    parser.add_argument("--messages", nargs="+", default=["ATT", "RATE"])
    parser.add_argument("--megabytes", type=float, default=20)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    versions = ", ".join(f"{name} {version(name)}" for name in ("greybox-id", "pymavlink", "numpy"))
    print(
        f"{date.today()}, {versions}, python {platform.python_version()}; medians of "
        f"{options.rounds} rounds"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = options.log or Path(folder) / "synthetic.BIN"
        if not options.log:
            synthetic(path, options.megabytes)
        print(f"{path.name}, {path.stat().st_size / 1e6:.1f} MB")
        ours(path, options.messages)  # imports, before anything is timed
        for messages in (options.messages[:1], options.messages, None):
            measure(path, messages, options.rounds)


if __name__ == "__main__":
    main()
