"""The command line: which commands there are, and what becomes of their answers and errors."""

import argparse
import contextlib
import json
import re
import sys
import traceback
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NoReturn

from greybox.cli import fit_command, inspect_command, list_command, response_command
from greybox.cli.options import UsageError
from greybox.cli.output import BAD_INPUT, FAILED

COMMANDS = (list_command, inspect_command, response_command, fit_command)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; see {self.prog} --help.")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status: 0 a usable answer, 1 a run that failed, 2 bad input."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in arguments

    try:
        options = _parser().parse_args(arguments)
    except UsageError as error:
        return _complain(str(error), BAD_INPUT, as_json)
    try:
        # With --json, whatever a user's own file prints must not reach standard output.
        with contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext():
            result, text, status = options.command(options)
    except SystemExit:
        return _complain("a file of your own called sys.exit: remove that call.", BAD_INPUT, as_json)
    except KeyboardInterrupt:
        return _complain("interrupted.", FAILED, as_json)
    except Exception as error:
        if "--debug" in arguments:
            traceback.print_exc()
        return _complain(*_explain(error, arguments), as_json=as_json)

    if "error" in result:
        print(f"greybox: {result['error']}", file=sys.stderr)
    with contextlib.suppress(BrokenPipeError):  # `greybox list | head`
        print(json.dumps(result, allow_nan=False, ensure_ascii=False) if as_json else text, flush=True)
        return status
    sys.stdout = None  # type: ignore[assignment]
    return status


def _complain(sentence: str, status: int, as_json: bool) -> int:
    print(f"greybox: {sentence}", file=sys.stderr)
    if as_json:
        print(json.dumps({"error": sentence}, ensure_ascii=False))
    return status


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="greybox", description="Grey-box estimation of models from flight data.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"greybox {version('greybox-id')}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for module in COMMANDS:
        module.add_command(commands)
    return parser


def _explain(error: Exception, arguments: Sequence[str]) -> tuple[str, int]:
    """Turn an exception into one sentence and an exit status; an error in a user's own file names file and line."""
    message = error.args[0] if isinstance(error, KeyError) and error.args else error  # str() of it would add quotes
    sentence = " ".join(str(message).split()) or type(error).__name__
    if isinstance(error, UsageError):
        return sentence, BAD_INPUT

    # The files of the user, by their full path, as they were written on the command line.
    users = {Path(m[1]).resolve(): m[1] for word in arguments if (m := re.match(r"(.+\.py)(?:$|[:(])", word))}
    if isinstance(error, SyntaxError) and error.filename and Path(error.filename).resolve() in users:
        return f"{users[Path(error.filename).resolve()]}, line {error.lineno}: {error.msg}.", BAD_INPUT

    causes = [error, *([error.__cause__] if error.__cause__ else [])]
    frames = [frame for cause in causes for frame in traceback.extract_tb(cause.__traceback__)]
    last = next((frame for frame in reversed(frames) if Path(frame.filename).resolve() in users), None)
    if last is not None:
        place = f"{users[Path(last.filename).resolve()]}, line {last.lineno}"
        return f"{place}: {type(error).__name__}: {sentence}", BAD_INPUT

    if isinstance(error, (ValueError, TypeError, LookupError, OSError)):
        return sentence, BAD_INPUT
    return f"internal error, {type(error).__name__}: {sentence}; run again with --debug and report it.", FAILED
