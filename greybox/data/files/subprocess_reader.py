"""Reads HDF5, MATLAB and PX4 files in a subprocess.

A damaged or crafted file can send the HDF5 library into an endless loop, crash it or scipy's MATLAB
reader, and make all of these and pyulog exhaust the memory. Python cannot catch most of that. So
`subprocess_main` reads the file in another process, with limits on processor time and memory where
the operating system has them. Wall-clock time is not limited: a slow machine does not make a file
damaged. The subprocess costs about 0.15 s per file, 0.3 s for MATLAB.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from greybox.data.files.control_characters import printable
from greybox.data.files.subprocess_main import REFUSED

SCRIPT = Path(__file__).with_name("subprocess_main.py")
# The exit status of a process that used up its processor time; Windows has no such limit.
TOO_LONG = -getattr(signal, "SIGPROF", 0)


def read_in_subprocess(kind: str, path: Path, *wanted: str) -> dict[str, Any]:
    """Return the report of `subprocess_main` on a file; its items have their `values`, an array.

    Raises
    ------
    ValueError
        If the file cannot be read, or not within the limits of processor time and memory.
    """
    # -P keeps the folder of the script off the path of imports, where its neighbors could hide
    # modules of Python; warnings would mix with the reason of a failure.
    options = ["-P", "-W", "ignore"]
    command = [sys.executable, *options, str(SCRIPT), kind, str(path.absolute()), *wanted]
    environment = {
        **os.environ,
        "OPENBLAS_NUM_THREADS": "1",  # every thread of it reserves memory
        "HDF5_PLUGIN_PRELOAD": "::",  # a file cannot have the HDF5 library load plugins
    }
    with (
        tempfile.TemporaryFile() as errors,  # a pipe that nobody reads would block the process
        subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=errors, env=environment
        ) as process,
    ):
        try:
            answer = _answer(process.stdout)
        except BaseException:
            # An interrupt must not leave the process behind.
            process.kill()
            raise
        status = process.wait()
        errors.seek(0)
        reason = printable(errors.read().decode("utf-8", "replace").strip())
    if status == REFUSED:
        raise ValueError(f"{path} cannot be read: {reason}.")
    if status == TOO_LONG:
        raise ValueError(f"{path} is damaged: reading it takes too long for its size.")

    if status < 0:
        raise ValueError(
            f"{path} is damaged: the library that reads it crashed; export or copy it again."
        )
    if status or answer is None:
        raise ValueError(
            f"{path} is damaged or of another format ({reason or 'no reason given':.160}): export "
            "or copy it again."
        )

    return answer


def _answer(pipe: Any) -> dict[str, Any] | None:
    """Return the answer, or None from a process that ended early."""
    try:
        # One line of facts, then the numbers, in the order of the items.
        report = json.loads(pipe.readline())
    except ValueError:
        return None
    for item in report["items"]:
        # Each array has memory of its own, which a record keeps without a copy.
        values = np.empty(item["shape"], "<f8")
        pipe.readinto(values)
        values.setflags(write=False)
        item["values"] = values

    return report
