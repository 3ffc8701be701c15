"""A fixed sample of the random cases, and the command that makes new ones."""

import subprocess
import sys
from pathlib import Path

import pytest

from differential.cases import FAMILIES, OPEN, run

# Cases of a family other than case 0 alone. Workers: one whose solver has finer steps before.
CASES = {
    "simulate": range(4),
    "cost": range(5),
    "linearized": range(3),
    "response": range(3),
    "response-of-states": range(3),
    "relation-workers": [1],
}
SAMPLE = [
    pytest.param(
        family,
        case,
        id=f"{family}-{case}",
        marks=[pytest.mark.skip(reason=OPEN[family])] if family in OPEN else [],
    )
    for family in FAMILIES
    for case in CASES.get(family, [0])
]


@pytest.mark.parametrize(("family", "case"), SAMPLE)
def test_the_answer_is_that_of_the_reference(family, case):
    assert run(family, case) is None


def test_only_public_names_of_greybox_are_used():
    for path in Path(__file__).parent.glob("*.py"):
        assert "from greybox" not in path.read_text().replace('"from greybox"', ""), path.name


def test_the_command_repeats_a_case_and_says_that_it_agrees():
    folder = Path(__file__).parent
    command = [sys.executable, str(folder), "--only", "cost", "--case", "0"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "cost 0: no difference\n"), done.stderr
