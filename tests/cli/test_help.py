"""What a new user types first: help; and what is shown on a terminal only."""

import argparse
import io
import json
import re
import shlex

import pytest
from command_line import OWN, refused, run

from greybox.cli.main import parser_of
from greybox.cli.terminal import colored, no_terminal

(COMMANDS,) = (
    action.choices
    for action in parser_of()._actions
    if isinstance(action, argparse._SubParsersAction)
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
        assert parser_of().parse_args(words).command  # a mistake would raise UsageError
    assert max(map(len, out.splitlines())) < 130


def test_the_help_says_where_to_begin(capsys):
    status, out, _ = run(capsys, "--help")
    assert status == 0
    for name, parser in COMMANDS.items():
        assert re.search(rf"^    {name} +\w", out, re.MULTILINE), name
        assert {"--json", "--quiet", "--debug"} <= set(parser._option_string_actions), name
    assert "greybox new problem mine" in out


def test_quiet_prints_errors_alone(capsys, own):
    name = own(OWN)
    assert run(capsys, "fit", name, "--quiet", "--out", "fit.h5") == (0, "", "")
    assert "exists" in refused(capsys, "fit", name, "--quiet", "--out", "fit.h5")
    out = run(capsys, "fit", name, "--quiet", "--json")[1]
    assert json.loads(out)["status"] == "converged"


class Terminal(io.StringIO):
    def isatty(self):
        return True


TEXT = "greybox: no.\n\n  K  1.0  AT BOUND  gain\n\n  warning: beware of a warning: this\n  FAILED: no start\n"


def test_colors_stand_on_terminals_only(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    shown = colored(TEXT, Terminal())
    assert re.sub(r"\x1b\[[\d;]*m", "", shown) == TEXT
    assert re.findall(r"\x1b\[[^0][\d;]*m(.*?)\x1b\[0m", shown) == [
        "greybox:",
        "AT BOUND",
        "  warning:",
        "  FAILED:",
    ]
    assert colored(TEXT, io.StringIO()) == TEXT
    assert colored(TEXT, None) == TEXT
    assert colored(TEXT, no_terminal(Terminal())) == TEXT
    monkeypatch.setenv("NO_COLOR", "1")
    assert colored(TEXT, Terminal()) == TEXT
    monkeypatch.delenv("NO_COLOR")
    monkeypatch.setenv("TERM", "dumb")
    assert colored(TEXT, Terminal()) == TEXT


def test_the_orders_that_are_tried_are_those_that_are_told():
    options = parser_of().parse_args(["orders", "response.csv"])
    told = re.search(
        r"--n .*?([\d ]+) by default.*--integrators .*?([\d ]+) by default",
        " ".join(COMMANDS["orders"].format_help().split()),
    )
    assert [*map(str, options.n)] == told[1].split()
    assert [*map(str, options.integrators)] == told[2].split()
