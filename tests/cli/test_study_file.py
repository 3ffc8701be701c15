"""What a study file states reaches its members, and what it does not say rightly is told."""

import re
import sys

import numpy as np
import pytest

import greybox as gb
from greybox.cli.options import UsageError
from greybox.cli.study_file import find_study, read_study_file

MODEL = """
import numpy as np
import greybox as gb

class Lag(gb.TransferFunction):
    input, output = "u", "y"
    K = gb.Parameter(1.0, bounds=(0.1, 10))
    T = gb.Parameter(0.1, bounds=(0.01, 1))
    c = gb.Parameter(1.0, bounds=(0, 2), fixed=True)

    def response(self, s, p):
        return p.c * p.K / (p.T * s + 1)
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "lag_of_study.py").write_text(MODEL)
    omega = np.array([1.0, 3.0, 10.0])
    made = gb.FrequencyResponse(omega, 2 / (0.05j * omega + 1), "u", "y", variance=np.full(3, 0.01))
    gb.data.write_response(made, tmp_path / "own.csv")
    yield tmp_path
    for name in ("lag_of_study", "other_study"):  # Python keeps modules by name
        sys.modules.pop(name, None)


def members(folder, text, **options):
    (folder / "study.toml").write_text(text)
    return read_study_file(folder / "study.toml", **options)


WHOLE = """
starts = 7
seed = 3

[[member]]
model = "lag_of_study.py:Lag"
data = "own.csv"
criterion = "maximum-likelihood"
free = ["c"]
bounds = {T = [0.02, 0.5]}
start = {T = 0.05}
starts_box = {K = [1, 3]}
prior = {c = [1.0, 0.1]}
search = "multistart"
name = "mine"

[[member]]
model = "lag_of_study.py:Lag"
data = ["own.csv"]
fix = [{K = 2}, {T = 0.05, K = 2.5}]
starts = 9
seed = [0, 1]
"""


def test_every_key_reaches_the_member(folder):
    whole, *grid = members(folder, WHOLE)
    assert (whole.name, whole.starts, whole.seed, whole.search) == ("mine", 7, 3, "multistart")
    problem = whole.problem
    assert problem.criterion == gb.MaximumLikelihood()
    assert {name for name, p in problem.parameters.items() if not p.fixed} == {"K", "T", "c"}
    assert problem.parameters["T"].bounds == (0.02, 0.5)
    assert problem.parameters["T"].start == 0.05
    assert problem.parameters["K"].box == (1.0, 3.0)
    assert [*problem.prior] == ["c"]
    assert [(m.name.split(": ")[1], m.starts, m.seed) for m in grid] == [
        ("K=2, seed 0", 9, 0),
        ("K=2, seed 1", 9, 1),
        ("T=0.05 K=2.5, seed 0", 9, 0),
        ("T=0.05 K=2.5, seed 1", 9, 1),
    ]
    assert [m.problem.fixed_values for m in grid[1:3]] == [{"K": 2.0}, {"T": 0.05, "K": 2.5}]
    assert [m.starts for m in members(folder, WHOLE, starts=4)] == [4] * 5


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("bounds = {T = [1]}", "T=1"),
        ("bounds = {T = [true, 2]}", "T=True:2"),
        ("prior = {T = 1.0}", "T=1.0"),
        ("starts_box = 3", "3"),
        ("start = {T = true}", "T=True"),
        ("method = 'magic'", "magic"),
        ("seed = true", "True"),
        ("starts = 'many'", "many"),
        ("data2 = 'own.csv'", "has 'data2', which is not known; use"),
    ],
)
def test_an_invalid_value_is_named(folder, line, message):
    with pytest.raises(UsageError, match=re.escape(message)):
        members(folder, f'[[member]]\nmodel = "lag_of_study.py:Lag"\ndata = "own.csv"\n{line}\n')


def test_files_of_other_kinds_and_without_members_are_told(folder):
    (folder / "study.txt").write_text("")
    with pytest.raises(
        UsageError,
        match=r"study\.txt is not a known kind of study file: write study\.toml, or study\.py",
    ):
        read_study_file(folder / "study.txt")
    with pytest.raises(
        UsageError, match=r"lag_of_study\.py has no function members\(\): define it"
    ):
        read_study_file(folder / "lag_of_study.py")
    (folder / "other_study.py").write_text("def members():\n    return [1]\n")
    with pytest.raises(
        UsageError,
        match=r"members\(\) in .*other_study\.py returns \[1\]: return a list of gb\.study\.Member",
    ):
        read_study_file(folder / "other_study.py")
    with pytest.raises(
        UsageError,
        match=r"there is no included study 'papers': the included one is paper; or give",
    ):
        find_study("papers")
    assert find_study("study.toml").name == "study.toml"
    assert find_study("paper").name == "_paper_study.py"
