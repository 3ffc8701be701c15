"""Files to start from run as they are, and find the numbers that they were made with."""

import json
import shlex
import sys

import pytest
from command_line import refused, run

TRUTH = {(): {"K": 60.0, "a": 2.0, "T": 0.06, "T_delay": 0.0}, ("--in-time",): {"c": 0.25}}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in ("fresh_problem_0", "fresh_problem_1"):
        sys.modules.pop(name, None)


def test_the_next_command_is_one_that_a_shell_reads(capsys, folder):
    (folder / "erste Größe").mkdir()
    said = json.loads(run(capsys, "new", "erste Größe/lag.py", "--json")[1])
    assert shlex.split(said["next"][0]) == ["greybox", "fit", "erste Größe/lag.py"]


@pytest.mark.parametrize("kind", TRUTH)
def test_a_problem_runs_as_it_is(capsys, folder, kind):
    name = f"fresh_problem_{len(kind)}"
    status, out, _ = run(capsys, "new", name, *kind, "--json")
    said = json.loads(out)
    assert status == 0
    assert said == {"file": f"{name}.py", "next": [f"greybox fit {name}.py"]}
    status, out, _ = run(capsys, *said["next"][0].split()[1:], "--json")
    found = json.loads(out)
    assert status == 0
    assert found["warnings"] == []
    for parameter, value in TRUTH[kind].items():
        error = found["standard_error"][parameter]
        assert abs(found["estimate"][parameter] - value) <= 3 * error, parameter
    status, out, _ = run(capsys, "list", f"{name}.py")
    assert status == 0
    assert f"FreshProblem{len(kind)}: " in out
    text = (folder / f"{name}.py").read_text()
    assert max(map(len, text.splitlines())) <= 120
    assert "{{" not in text


def test_nothing_is_overwritten_or_hidden(capsys, folder):
    (folder / "mine.py").write_text("precious")
    assert "mine.py exists: give another name, or --force" in refused(capsys, "new", "mine")
    assert (folder / "mine.py").read_text() == "precious"
    assert run(capsys, "new", "mine", "--force")[0] == 0
    for name in ("numpy", "json.py", "greybox"):
        assert "is the name of a Python package" in refused(capsys, "new", name)
    assert "'2 pitch' cannot be the name of a Python file" in refused(capsys, "new", "2 pitch")
    assert "the folder of missing" in refused(capsys, "new", "missing/pitch")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("a1_rate", "A1Rate"),
        ("x", "X"),
        ("_2dof", "Model2dof"),
        ("pitchRate_fast", "PitchRateFast"),
    ],
)
def test_a_class_has_the_name_of_its_file(capsys, folder, name, expected):
    assert run(capsys, "new", f"{name}.py")[0] == 0
    assert f"\nclass {expected}(" in (folder / f"{name}.py").read_text()
