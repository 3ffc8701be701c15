"""What a study file states reaches its members, and what it does not say rightly is told."""

import re
import shutil
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
        ("bounds = {T = [1]}", "T: bounds (1,) must be a pair"),
        ("bounds = {T = ['low', 2]}", "'low'"),
        ("prior = {T = 1.0}", "prior of T 1.0 must be a pair"),
        ("starts_box = 3", "3"),
        ("start = {T = 'low'}", "'low'"),
        ("method = 'magic'", "has no method 'magic'"),
        ("seed = true", "True"),
        ("starts = 'many'", "many"),
        ("data2 = 'own.csv'", "has no key 'data2'; it has"),
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
    with pytest.raises(UsageError, match=r"members\(\) in .*lag_of_study\.py is missing"):
        read_study_file(folder / "lag_of_study.py")
    (folder / "other_study.py").write_text("def members():\n    return [1]\n")
    with pytest.raises(
        UsageError,
        match=r"members\(\) in .*other_study\.py is missing or returns \[1\]",
    ):
        read_study_file(folder / "other_study.py")
    assert find_study("study.toml").name == "study.toml"
    assert find_study("paper").name == "_paper_study.py"


GRID = """
model = ["lag_of_study.py:Lag", "lag_of_study.py:Slow"]
data = "flights/*.csv"
held = "flights/f2.csv"
starts = 3
"""


@pytest.fixture
def flights(folder):
    (folder / "flights").mkdir()
    for k in range(3):
        shutil.copy(folder / "own.csv", folder / "flights" / f"f{k}.csv")
    slow = "\n\nclass Slow(Lag):\n    T = gb.Parameter(1.0, bounds=(0.1, 3))\n"
    (folder / "lag_of_study.py").write_text(MODEL + slow)
    return folder


def test_structures_on_the_files_of_a_folder_are_a_file_of_five_lines(flights):
    made = members(flights, GRID)
    assert [m.name for m in made] == ["f0: Lag", "f0: Slow", "f1: Lag", "f1: Slow"]
    assert [type(m.problem.model).__name__ for m in made] == ["Lag", "Slow"] * 2
    assert made[0].problem.data is made[1].problem.data  # read once
    assert {m.starts for m in made} == {3}


@pytest.mark.parametrize(
    ("lines", "names", "parts"),
    [
        (
            'data = ["flights/f0.csv", ["flights/f0.csv", "flights/f1.csv"]]',
            ["f0", "f0+f1"],
            [1, 2],
        ),
        ('joint = "flights/*.csv"', ["f0+f1+f2"], [3]),
        ('joint = ["flights/f0.csv", "flights/f[12].csv"]', ["f0+f1+f2"], [3]),
        (
            'data = "own.csv"\nband = [[1, 3], [1, 10]]',
            ["own: band 1 3", "own: band 1 10"],
            [1, 1],
        ),
        ('data = "own.csv"\nfree = [[], ["c"]]', ["own: free nothing", "own: free c"], [1, 1]),
        ('data = "own.csv"\nstarts = [2, 4]', ["own: starts 2", "own: starts 4"], [1, 1]),
        (
            'data = ["own.csv", "flights/f0.csv"]\nname = "mine"',
            ["mine: own", "mine: flights/f0"],
            [1, 1],
        ),
    ],
)
def test_lists_multiply_and_lists_within_them_are_joint(flights, lines, names, parts):
    made = members(flights, f'model = "lag_of_study.py:Lag"\n{lines}\n')
    assert [m.name for m in made] == names
    assert [len(m.problem.parts) for m in made] == parts


def test_a_band_is_of_the_data(flights):
    for member, count in zip(
        members(
            flights, 'model = "lag_of_study.py:Lag"\ndata = "own.csv"\nband = [[1, 3], [2, 9]]'
        ),
        (2, 1),
        strict=True,
    ):
        assert len(member.problem.data) == count


def test_several_grids_share_the_keys_above_them(flights):
    text = """
    starts = 4
    [[member]]
    model = "lag_of_study.py:Lag"
    data = "flights/f[01].csv"
    [[member]]
    model = "lag_of_study.py:Slow"
    data = "flights/f[01].csv"
    name = "slow"
    starts = 2
    [[member]]
    problem = "pitch_hover"
    """
    made = members(flights, text)
    assert [m.name for m in made] == ["f0", "f1", "slow: f0", "slow: f1", "pitch_hover"]
    assert [m.starts for m in made] == [4, 4, 2, 2, 4]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('data = "flights/*.txt"', "'flights/*.txt' matches no file in"),
        ("data = []", "data"),
        ('data = "own.csv"\nseed = []', "seed is empty: give at least one value"),
        ('data = "own.csv"\nband = [20, 30]', "member 'own': "),
        ('data = "own.csv"\nmethod = "collocation"', "member 'own': method=... is for records"),
        ('data = "none.csv"', "'none.csv' matches no file in"),
        ('data = "own.csv"\nprepare = {signals = {u = "A.b"}}', "A"),
    ],
)
def test_a_mistake_in_a_grid_names_key_value_and_cure(flights, lines, message):
    with pytest.raises((UsageError, ValueError), match=re.escape(message)) as refused:
        members(flights, f'model = "lag_of_study.py:Lag"\n{lines}\n')
    assert "--" not in str(refused.value)
