"""The command `greybox completion`: what a shell needs to complete commands, options and names."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from greybox.cli.catalog import shipped
from greybox.cli.options import UsageError, add_common_options
from greybox.cli.output import USABLE, Answer
from greybox.files.optional_package import required

SHELLS = ("bash", "zsh", "tcsh")
EXAMPLES = (
    "bash > ~/.local/share/bash-completion/completions/greybox",
    "zsh > ~/.zfunc/_greybox",
)
PROBLEMS = {
    "bash": "_greybox_problems() {{ compgen -W '{names}' -- \"$1\"; compgen -f -X '!*.py' -- \"$1\"; }}",
    "zsh": "_greybox_problems() {{ compadd {names}; _files -g '*.py' }}",
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "shell",
        choices=SHELLS,
        help="which prints a script: keep it where the shell looks for such",
    )
    add_common_options(parser)


def run(options: argparse.Namespace) -> Answer:
    """Print the script, which shtab makes of the declared options."""
    try:
        shtab = required("shtab", "completion", "greybox completion")
    except ModuleNotFoundError as error:
        raise UsageError(str(error)) from None
    parser = options.parser_of()
    for action in _actions(parser):
        if action.dest == "problem" and not action.option_strings:
            action.complete = dict.fromkeys(PROBLEMS, "_greybox_problems") | {"tcsh": "f"}  # type: ignore[attr-defined]
        elif action.type is Path or action.metavar in ("FILE", "LOG", "STUDY"):
            action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE  # type: ignore[attr-defined]
    names = " ".join(shipped("problems"))
    preamble = {shell: function.format(names=names) for shell, function in PROBLEMS.items()}
    script = shtab.complete(parser, shell=options.shell, preamble=preamble)
    return {"shell": options.shell, "script": script}, script, USABLE


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield all arguments of a parser and of its commands."""
    for action in parser._actions:  # argparse has no other way to them
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _actions(command)
