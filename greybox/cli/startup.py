"""Ctrl-C while the command line is still being imported, which takes half a second: it ends without a traceback.

Python imports the package `greybox` before it calls any function of the command line. This is
therefore what the package imports first, and it needs nothing of it.
"""

import os
import signal
import sys

INTERRUPTED = 130  # exit status, as of a program that a shell saw end by Ctrl-C


def guard_imports() -> None:
    """Let Ctrl-C end this process at once if it is that of the command line; nothing has begun that it could break."""
    if _is_command_line() and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)


def end_guard() -> None:
    """Let Ctrl-C raise KeyboardInterrupt from now on."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _is_command_line() -> bool:
    if sys.argv[:1] == ["-m"]:  # python -m something, and Python is still looking for it
        return sys.orig_argv[-len(sys.argv)] in ("greybox", "-mgreybox")
    return bool(sys.argv) and os.path.splitext(os.path.basename(sys.argv[0]))[0] == "greybox"


def _leave(*_: object) -> None:
    os.write(2, b"greybox: interrupted.\n")
    if "--json" in sys.argv:
        os.write(1, b'{"error": "interrupted."}\n')
    os._exit(INTERRUPTED)
