"""What a new user types first: help."""

import argparse
import json
import re
import shlex

import pytest
from command_line import OWN, refused, run

from greybox.cli.main import parser_of

PARSER = parser_of()
(COMMANDS,) = (
    action.choices for action in PARSER._actions if isinstance(action, argparse._SubParsersAction)
)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_examples_that_are_understood(capsys, name):
    status, out, _ = run(capsys, name, "--help")
    assert status == 0
    examples = re.findall(
        rf"^  greybox ({name}\b.*)$", out.partition("examples:\n")[2], re.MULTILINE
    )
    assert examples
    for line in examples:
        words = shlex.split(line.partition(" > ")[0])
        assert PARSER.parse_args(words).command  # a mistake would raise UsageError
    assert max(map(len, out.splitlines())) < 130


def test_the_help_says_where_to_begin(capsys):
    status, out, _ = run(capsys, "--help")
    assert status == 0
    for name, parser in COMMANDS.items():
        assert re.search(rf"^    {name} +\w", out, re.MULTILINE), name
        assert all(option in parser.format_help() for option in ("--json", "--quiet", "--debug"))
    assert "greybox new mine" in out


def test_quiet_prints_errors_alone(capsys, own):
    name = own(OWN)
    assert run(capsys, "fit", name, "--quiet", "--out", "fit.h5") == (0, "", "")
    assert "exists" in refused(capsys, "fit", name, "--quiet", "--out", "fit.h5")
    out = run(capsys, "fit", name, "--quiet", "--json")[1]
    assert json.loads(out)["status"] == "converged"
