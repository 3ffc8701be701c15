"""Files that are read in a subprocess: HDF5, MATLAB, PX4, and the results that greybox saved as HDF5.

A damaged or crafted file can send the HDF5 library into an endless loop, crash it or scipy's MATLAB
reader, and make all of them, and pyulog, exhaust the memory; little of that can be caught in
Python. So `subprocess_main` reads the file in another process, with a limit of its time and, where
the system has one, of its memory. That costs about 0.15 s per file, 0.3 s for MATLAB.
"""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import numpy as np

from greybox.files.arrays import Array
from greybox.files.progress import waiting
from greybox.files.subprocess_main import REFUSED
from greybox.files.text_table import printable

Answer = tuple[dict[str, Any], list[Array]]

SCRIPT = Path(__file__).with_name("subprocess_main.py")

# Time limit: s, and more for a large file at bytes per s. It ends what waits; `subprocess_main`
# ends what computes, by its processor time, much earlier. On a busy machine, starting Python and
# scipy took 1.7 s and reading ran at 30 MB/s (HDF5 and MATLAB, 32 MB).
PATIENCE = 10.0
SPEED = 2e6
LOOK = 0.2  # s, after which a reader looks how long it has waited
TOO_LONG = -getattr(
    signal, "SIGPROF", 0
)  # the exit status of a process that used up its processor time


def read_in_subprocess(kind: str, path: Path, *wanted: str) -> Answer:
    """Return what the function of this `kind` in `subprocess_main` says of a file, and its numeric arrays.

    Raises
    ------
    ValueError
        If the file cannot be read, or not within the limits of time and memory.
    """
    limit = PATIENCE + path.stat().st_size / SPEED
    command = [
        sys.executable,
        "-P",
        "-W",
        "ignore",
        str(SCRIPT),
        kind,
        str(path.absolute()),
        *wanted,
    ]
    environment = {
        **os.environ,
        "OPENBLAS_NUM_THREADS": "1",  # every thread of it reserves memory
        "HDF5_PLUGIN_PRELOAD": "::",  # a file cannot have the HDF5 library load plugins
    }
    status, answer, complaint = _finished(command, environment, limit, path)
    said = printable(complaint.decode("utf-8", "replace").strip())
    if status == REFUSED:
        raise ValueError(f"{path} is not read: {said}.")
    if status == TOO_LONG:
        raise ValueError(f"{path} is damaged: reading it takes too long for its size.")
    if status < 0:
        raise ValueError(
            f"{path} is damaged: the library that reads it crashed; export or copy it again."
        )
    if status:
        reason = said or "for no stated reason"
        raise ValueError(
            f"{path} is damaged or of another format ({reason:.160}): export or copy it again."
        )
    return answer.result()


def _finished(
    command: list[str], environment: dict[str, str], limit: float, path: Path
) -> tuple[int, "Future[Answer]", bytes]:
    """Run a command, and return its exit status, its answer and complaint; a large file is seen to take its time."""
    pipe = subprocess.PIPE
    with (
        waiting(f"reading {printable(path.name)}") as bar,
        subprocess.Popen(command, stdout=pipe, stderr=pipe, env=environment) as process,
        ThreadPoolExecutor(2) as readers,
    ):
        assert process.stderr
        begin = time.monotonic()
        try:
            answer, complaint = (
                readers.submit(_answer, process.stdout),
                readers.submit(process.stderr.read),
            )
            while wait((answer, complaint), LOOK).not_done:
                if time.monotonic() - begin > limit:
                    raise ValueError(
                        f"{path} is damaged: reading it took longer than {limit:.0f} s."
                    )
                bar.update()
            return process.wait(), answer, complaint.result()
        except BaseException:
            process.kill()
            raise


def _answer(pipe: Any) -> Answer:
    """Read an answer, each array into memory of its own, which a record keeps."""
    try:
        head = json.loads(pipe.readline())
        arrays = []
        for shape in head.pop("shapes"):
            values = np.empty(shape, "<f8")
            if values.size:
                pipe.readinto(values.data.cast("B"))
            values.setflags(write=False)
            arrays.append(values)
        return head, arrays
    finally:
        pipe.read()  # of an answer that cannot be read: until then the process waits
