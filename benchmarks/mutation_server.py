"""Run chosen tests in forks of a process that has imported libraries, but nothing with a fault.

Imports take most of the time of a short run. `mutation.py` starts one server in each copy of the
package, and writes one request a line: the file with the tests, that for the output, the limits of
processor time and of the clock.
"""

import contextlib
import importlib
import json
import os
import resource
import signal
import sys
import time

LIBRARIES = (
    "casadi",
    "coverage",
    "h5py",
    "hypothesis",
    "matplotlib.pyplot",
    "numpy",
    "pytest",
    "scipy.integrate",
    "scipy.interpolate",
    "scipy.optimize",
    "scipy.signal",
    "scipy.stats",
    "xdist",
)
MEMORY = (
    4 * 2**30
)  # bytes of addresses, several times what any test takes: a fault can make an array without end
# Plugins are imported already: pytest cannot rewrite their assertions, and says so.
OPTIONS = "-p mutation_plugin -p no:cacheprovider -p no:benchmark -n 0 -x --tb=line -W".split()
OPTIONS += ["ignore::pytest.PytestAssertRewriteWarning"]


def status_of(child: int, waiting: float) -> int | None:
    """Wait for the end of a process.

    None where it never came, and was killed with all that it started.
    """
    end, status = time.monotonic() + waiting, None
    while status is None and time.monotonic() < end:
        ended, how = os.waitpid(child, os.WNOHANG)
        if ended:
            status = os.waitstatus_to_exitcode(how)
        else:
            time.sleep(0.02)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    if status is None:
        os.waitpid(child, 0)
    return status


def run(order: str, output: str, limit: int) -> None:
    """Run the tests in this process, and end it."""
    os.setsid()
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    for source, flags, targets in (
        (os.devnull, os.O_RDONLY, (0,)),
        (output, os.O_WRONLY | os.O_CREAT, (1, 2)),
    ):
        opened = os.open(source, flags)
        for target in targets:
            os.dup2(opened, target)
    os.environ["GREYBOX_MUTATION_ORDER"] = order
    with open(order) as file:
        files = dict.fromkeys(line.rstrip("\n").partition("::")[0] for line in file)
    sys.exit(importlib.import_module("pytest").main([*OPTIONS, *files]))


if __name__ == "__main__":
    for name in LIBRARIES:
        importlib.import_module(name)
    for line in sys.stdin:
        request = json.loads(line)
        child = os.fork()
        if not child:
            run(request["order"], request["output"], request["limit"])
        print(json.dumps(status_of(child, request["waiting"])), flush=True)
