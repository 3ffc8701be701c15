"""Files that a test wrote itself, read without the process in which those of others are read."""

import json
import warnings

import numpy as np

from greybox.data.files.subprocess_main import EXPANSION, KINDS, SMALL, Collector, RefusedError


def read_here(kind, path, *wanted):
    """As `greybox.data.files.subprocess_reader.read_in_subprocess`, without the limits of time and
    memory."""
    size = path.stat().st_size
    found = Collector(max(SMALL, EXPANSION * size))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            KINDS[kind][1](str(path), found, list(wanted))
    except RefusedError as reason:
        raise ValueError(f"{path} cannot be read: {reason}.") from None
    except Exception as problem:
        said = f"{type(problem).__name__}: {problem}"
        raise ValueError(
            f"{path} is damaged or of another format ({said:.160}): export or copy it again."
        ) from None
    report = json.loads(
        json.dumps({"items": found.items, "findings": found.findings, "about": found.about})
    )
    for item, array in zip(report["items"], found.arrays, strict=True):
        item["values"] = np.array(array, dtype="<f8", order="C")
        item["values"].setflags(write=False)
    return report
