"""The command line: which commands there are, and what becomes of their answers and errors."""

import argparse
import contextlib
import io
import json
import re
import sys
import traceback
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn

from greybox.cli import (
    batch_command,
    bootstrap_command,
    compare_command,
    completion_command,
    fit_command,
    identifiability_command,
    identify_command,
    inspect_command,
    list_command,
    new_command,
    orders_command,
    plot_command,
    profile_command,
    reduce_command,
    report_command,
    response_command,
    stepwise_command,
)
from greybox.cli.options import HelpFormatter, UsageError
from greybox.cli.output import (
    BAD_INPUT,
    FAILED,
    NO_WORKING_DIRECTORY,
    USABLE,
    Answer,
    has_working_directory,
)
from greybox.cli.startup import INTERRUPTED
from greybox.cli.terminal import colored, has_all_characters, no_terminal, write
from greybox.files.text_table import alternatives, nearest, printable
from greybox.modeling.model_reference import UnknownModelError
from greybox.solve.interruption import Response, listening, responding, take_interrupt

COMMANDS = (
    list_command,
    inspect_command,
    identify_command,
    response_command,
    orders_command,
    identifiability_command,
    fit_command,
    plot_command,
    profile_command,
    bootstrap_command,
    reduce_command,
    stepwise_command,
    batch_command,
    compare_command,
    report_command,
    new_command,
    completion_command,
)

BEGIN = """\
begin with:
  greybox list
  greybox fit pitch_hover
  greybox new problem mine
`greybox COMMAND --help` has examples of each."""


class _Parser(argparse.ArgumentParser):
    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """Refuse what is not known where it is known what was possible: in the command's own parser."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            near = nearest(unknown[0].partition("=")[0], self._option_string_actions)
            hint = f", did you mean {near}?" if near and unknown[0].startswith("-") else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
        return found, unknown

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            choices = alternatives(value, action.choices)
            raise argparse.ArgumentError(action, f"there is no {value!r}; there are {choices}")

    def error(self, message: str) -> NoReturn:
        raise UsageError(
            f"{message.rstrip('.')}{' See' if message.endswith('?') else '; see'} {self.prog} --help."
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status.

    0 a usable answer, 1 a run that failed, 2 bad usage or bad input, 130 interrupted by Ctrl-C.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in arguments

    try:
        with listening():
            answer = _answer(arguments, as_json)
            with responding(Response.FINISH):
                status = _tell(*answer, as_json)
            return INTERRUPTED if take_interrupt() else status
    except KeyboardInterrupt:
        return _tell({"error": "interrupted."}, "", INTERRUPTED, as_json)


def _answer(arguments: Sequence[str], as_json: bool) -> Answer:
    """Run the command; an error is an answer too."""
    help_or_version = io.StringIO()
    try:
        with contextlib.redirect_stdout(help_or_version):
            options = _parser().parse_args(
                arguments, argparse.Namespace(arguments=tuple(arguments))
            )
    except UsageError as error:
        return {"error": str(error)}, "", BAD_INPUT
    except SystemExit:
        return {}, help_or_version.getvalue().rstrip("\n"), USABLE
    try:
        # With --json, whatever a user's own file prints must not reach standard output; what is
        # quiet shows no bars.
        with (
            contextlib.redirect_stderr(no_terminal(sys.stderr))
            if options.quiet
            else contextlib.nullcontext(),
            contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext(),
        ):
            result, text, status = options.command(options)
        return result, "" if options.quiet else text, status
    except SystemExit:
        return {"error": "a file of your own called sys.exit: remove that call."}, "", BAD_INPUT
    except Exception as error:
        if take_interrupt():  # which caused it
            raise KeyboardInterrupt from error
        if "--debug" in arguments:
            traceback.print_exc()
        sentence, status = _explain(error, arguments)
        return {"error": sentence}, "", status


def _tell(result: dict[str, Any], text: str, status: int, as_json: bool) -> int:
    """Write an answer, and return the exit status."""
    if "error" in result:
        write(colored(printable(f"greybox: {result['error']}", keep="\n"), sys.stderr), sys.stderr)
    text = colored(
        printable(text, keep="\n\t"), sys.stdout
    )  # of names of files, which a user did not type but got
    if as_json and result:
        text = json.dumps(result, allow_nan=False, ensure_ascii=not has_all_characters(sys.stdout))
    trouble = write(text, sys.stdout) if text else ""
    if trouble:
        write(f"greybox: cannot write to standard output: {trouble}.", sys.stderr)
    return FAILED if trouble and status == USABLE else status


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="greybox",
        description="Grey-box estimation of models from flight data.",
        epilog=BEGIN,
        formatter_class=HelpFormatter,
        allow_abbrev=False,
    )
    parser.set_defaults(whole_parser=parser)
    parser.add_argument("--version", action="version", version=f"greybox {version('greybox-id')}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for module in COMMANDS:
        module.add_command(commands)
    return parser


def _explain(error: Exception, arguments: Sequence[str]) -> tuple[str, int]:
    """Turn an exception into one sentence and an exit status; an error in a user's own file names file and line."""
    message = (
        error.args[0] if isinstance(error, KeyError) and error.args else error
    )  # str() of it would add quotes
    sentence = " ".join(str(message).split()) or type(error).__name__
    if isinstance(error, UnknownModelError):
        sentence = f"{error.missing}: give its file, --model my.py."
    if isinstance(error, UsageError):
        return sentence, BAD_INPUT

    # The files of the user, by their full path, as they were written on the command line.
    users = {
        _full_path(m[1]): m[1] for word in arguments if (m := re.match(r"(.+\.py)(?:$|[:(])", word))
    }
    if isinstance(error, SyntaxError) and error.filename and _full_path(error.filename) in users:
        return f"{users[_full_path(error.filename)]}, line {error.lineno}: {error.msg}.", BAD_INPUT

    causes = [error, *([error.__cause__] if error.__cause__ else [])]
    frames = [frame for cause in causes for frame in traceback.extract_tb(cause.__traceback__)]
    last = next((frame for frame in reversed(frames) if _full_path(frame.filename) in users), None)
    if last is not None:
        place = f"{users[_full_path(last.filename)]}, line {last.lineno}"
        return f"{place}: {type(error).__name__}: {sentence}", BAD_INPUT

    if isinstance(error, FileNotFoundError) and not has_working_directory():
        return NO_WORKING_DIRECTORY, BAD_INPUT
    if isinstance(error, (ValueError, TypeError, LookupError, OSError, ModuleNotFoundError)):
        return sentence, BAD_INPUT
    return (
        f"internal error, {type(error).__name__}: {sentence}; run again with --debug and report it.",
        FAILED,
    )


def _full_path(path: str) -> Path:
    """Return the path from the root, or as it is where there is no working directory."""
    try:
        return Path(path).resolve()
    except FileNotFoundError:
        return Path(path)
