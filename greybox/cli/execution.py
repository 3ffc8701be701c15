"""Run a command: its answer, Ctrl-C, and errors as sentences."""

import argparse
import contextlib
import io
import sys
import traceback
import warnings
from typing import Any

from greybox.cli.options import UsageError, as_options
from greybox.cli.output import BAD_INPUT, FAILED, INTERRUPTED, USABLE, write_answer
from greybox.cli.terminal import write
from greybox.data.files.error_place import error_place
from greybox.data.files.escapes import sentence
from greybox.engine.solve.interruption import (
    Response,
    ended_status,
    listening,
    responding,
    take_interrupt,
)
from greybox.engine.solve.lost_workers import ExecutorLostError


def execute(options: argparse.Namespace) -> int:
    """Run the command of the parsed `options`, write its answer, and return the exit status."""
    # Ctrl-C during the output must not leave half a JSON object.
    with listening(), warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: write(f"greybox: {message}", sys.stderr)
        try:
            result, text, status = _answer(options)
        except KeyboardInterrupt:
            result = {"error": "interrupted."}
            text = ""
            status = INTERRUPTED
        with responding(Response.FINISH):
            status = write_answer(result, text, options.json, status)
        return ended_status() if take_interrupt() or status == INTERRUPTED else status


def _answer(options: argparse.Namespace) -> tuple[dict[str, Any], str, int]:
    """Run the command; an error is an answer too, with its exit status."""
    with contextlib.ExitStack() as streams:
        if options.quiet:  # no progress bars, no warnings
            streams.enter_context(contextlib.redirect_stderr(io.StringIO()))
        if options.json:  # what a user's own file prints must not reach standard output
            streams.enter_context(contextlib.redirect_stdout(sys.stderr))
        try:
            result, *lines = options.command(options)
            # Texts and warnings name the arguments that would choose otherwise.
            text = "" if options.quiet else as_options("\n".join(lines), options)
            if error := result.get("error"):
                result["error"] = as_options(error, options)
            return result, text, USABLE
        except SystemExit:  # argparse has finished by now: only a user's file calls it here
            return {"error": "a file of your own called sys.exit: remove that call."}, "", BAD_INPUT
        except Exception as error:
            # Libraries turn Ctrl-C into errors of their own.
            if take_interrupt():
                raise KeyboardInterrupt from error
            if options.debug:
                traceback.print_exc()
            if isinstance(error, ExecutorLostError):
                stored = "; the same command continues with the stored runs" if options.out else ""
                return {"error": f"{str(error).rstrip('.')}{stored}."}, "", FAILED
            message, status = _explain(error)
            if not isinstance(error, UsageError):
                message = as_options(message, options)
            return {"error": sentence(message)}, "", status


def _explain(error: Exception) -> tuple[str, int]:
    """Return an exception as one sentence with an exit status.

    For an error inside a user's own file the sentence names file and line.
    """
    is_key_error = isinstance(error, KeyError) and error.args
    message = error.args[0] if is_key_error else error  # str() of a KeyError adds quotes
    text = " ".join(str(message).split()) or type(error).__name__
    if isinstance(error, UsageError):
        return text, BAD_INPUT

    if place := error_place(error):
        if isinstance(error, SyntaxError):  # its sentence ends with the place
            return f"{place}{error.msg}.", BAD_INPUT
        return f"{place}{type(error).__name__}: {text}", BAD_INPUT

    # The library raises these for bad input; anything else is a defect of greybox.
    if isinstance(error, ValueError | TypeError | LookupError | OSError | ModuleNotFoundError):
        return text, BAD_INPUT
    text = f"internal error, {type(error).__name__}: {text}"
    return f"{text}; run again with --debug and report it.", FAILED
