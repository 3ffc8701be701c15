"""`python -m greybox` and the `greybox` command are the same."""

import signal
import sys

from greybox.cli.main import main as run
from greybox.cli.terminal import make_writable


def main() -> int:
    """Run the command line as a process of its own, and return its exit status."""
    sys.unraisablehook = _unraisable
    make_writable()
    status = run()
    # Python still has to tidy up, which Ctrl-C would interrupt with a traceback.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return status


def _unraisable(error: "sys.UnraisableHookArgs") -> None:
    """Do not report Ctrl-C in a destructor: `greybox.engine.solve.interruption` notes it."""
    if not isinstance(error.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(error)


if __name__ == "__main__":
    sys.exit(main())
