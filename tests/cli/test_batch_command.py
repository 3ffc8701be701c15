"""`greybox batch` and `greybox compare`, as they are typed."""

import json
import os
import shlex
import shutil
import signal
import sqlite3
import sys
from contextlib import closing
from pathlib import Path
from unittest.mock import Mock

import pytest

from greybox.cli.main import main
from greybox.engine.solve.lost_workers import ExecutorLostError
from greybox.workflows.study.stored_runs import StoredRuns
from greybox.workflows.study.study_lock import locked

STUDY = """
starts = 4

[[member]]
problem = "yaw_hover"

[[member]]
problem = "mine.py:small"
criterion = ["relative-error", "magnitude-phase"]
seed = [0, 1]

[[member]]
problem = "mine.py:small"
fix = [{}, {T = 0.05}]
"""
TWO_SEEDS = '[[member]]\nproblem = "mine.py:small"\nstarts = 12\nseed = [0, 1]\n'

MINE = """
import numpy as np
import greybox as gb

class Lag(gb.TransferFunction):
    input, output = "u", "y"
    K = gb.Parameter(1.0, bounds=(0.1, 10))
    T = gb.Parameter(0.1, bounds=(0.01, 1))

    def response(self, s, p):
        return p.K / (p.T * s + 1)

def small():
    omega = np.array([1.0, 3, 10, 30])
    rng = np.random.default_rng(1)
    response = 2 / (0.05j * omega + 1) * (1 + 0.01 * rng.standard_normal(4))
    return gb.Problem(Lag(), gb.FrequencyResponse(omega, response, "u", "y"))
"""


@pytest.fixture
def study(tmp_path, monkeypatch):
    folder = tmp_path / "files"
    folder.mkdir()
    (folder / "study.toml").write_text(STUDY)
    (folder / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    yield folder / "study.toml"
    sys.modules.pop("mine", None)  # Python keeps modules by name


def answer(capsys, *words):
    status = main([*map(str, words), "--json"])
    shown = capsys.readouterr()
    return status, json.loads(shown.out), shown.err


def test_a_study_is_run_compared_and_resumed(study, tmp_path, capsys):
    status, found, _ = answer(capsys, "batch", study, "--out", "out")
    assert status == 0
    assert [member["name"] for member in found["members"]] == [
        "yaw_hover",
        "mine:small: relative-error, seed 0",
        "mine:small: relative-error, seed 1",
        "mine:small: magnitude-phase, seed 0",
        "mine:small: magnitude-phase, seed 1",
        "mine:small: nothing fixed",
        "mine:small: T=0.05",
    ]
    assert all(member["status"] == "done" and member["runs"] == 4 for member in found["members"])
    assert found["members"][6]["answer"]["standard_error"]["T"] == 0

    assert answer(capsys, "compare", "out")[:2] == (0, found)
    assert main(["compare", "out"]) == 0
    table = capsys.readouterr().out
    assert "Study out, 7 members: 7 done" in table
    assert "mine:small: T=0.05" in table
    assert answer(capsys, "batch", study, "--out", "out")[:2] == (0, found)

    status, more, _ = answer(capsys, "batch", study, "--out", "out", "--starts", 6)
    assert status == 0
    assert all(member["runs"] == 6 for member in more["members"])
    assert more["members"][0]["answer"]["cost"] == pytest.approx(
        found["members"][0]["answer"]["cost"]
    )


def test_a_dry_run_lists_the_members_and_writes_nothing(study, tmp_path, capsys):
    status, listed, _ = answer(capsys, "batch", study, "--dry-run")
    assert status == 0
    assert listed["starts"]["mine:small: magnitude-phase, seed 1"] == 4
    assert main(["batch", str(study), "--dry-run"]) == 0
    assert capsys.readouterr().out.endswith("7 members, at most 28 starts\n")
    assert {path.name for path in tmp_path.iterdir()} == {"files"}


def test_a_study_in_python(tmp_path, capsys):
    path = tmp_path / "study_of_two_seeds.py"
    path.write_text(
        MINE
        + "\ndef members():\n    return [gb.study.Member(small(), 5, seed=k, name=f'seed {k}') for "
        "k in range(2)]\n"
    )
    status, found, _ = answer(capsys, "batch", path, "--out", tmp_path / "out", "--workers", 2)
    assert status == 0
    assert [member["name"] for member in found["members"]] == ["seed 0", "seed 1"]


def test_members_without_an_answer_are_named(study, capsys):
    study.write_text(
        '[[member]]\nproblem = "mine.py:small"\nstarts = 5\n[[member]]\n'
        'problem = "mine.py:hopeless"\nstarts = 2\n'
    )
    (study.parent / "mine.py").write_text(
        MINE + "\ndef hopeless():\n    return small().with_(constraints=[lambda p: -1 - p.K**2])\n"
    )
    status, found, said = answer(capsys, "batch", study, "--out", "out")
    assert status == 1
    assert found["error"] == "1 of 2 members have no answer: mine:hopeless."
    assert "greybox: 1 of 2 members" in said
    assert found["members"][1]["error"].startswith("no start converged")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[member]", "study.toml is not TOML"),
        ("", "give either a problem or model=... with data=..."),
        ("star = 3\n[[member]]\nproblem = 'rotors'", "has no key 'star'; it has"),
        ("[[member]]\nproblems = 'rotors'", "has no key 'problems'; it has"),
        (
            "[[member]]\nproblem = 'rotorz'",
            "there is no included problem 'rotorz'",
        ),
        ("[[member]]\nproblem = 'rotors'\ncriterion = 3", "3"),
        ("[[member]]\nproblem = 'rotors'\nseed = [0, 'a']", "'a'"),
        ("[[member]]\nproblem = 'rotors'\nstarts = 'a'", "goes with a number of starts"),
        ("[[member]]\nproblem = 'rotors'\nfix = 3", "3"),
        ("[[member]]\nproblem = 'rotors'\nfix = {T_delay = 'a'}", "'a'"),
        (
            "[[member]]\nproblem = 'rotors'\n[[member]]\nproblem = 'rotors'",
            "2 members have the name 'rotors'",
        ),
    ],
)
def test_what_is_wrong_in_a_study_file_is_said_before_anything_is_written(
    study, tmp_path, capsys, text, said
):
    study.write_text(text)
    status, found, _ = answer(capsys, "batch", study, "--out", "out")
    assert status == 2
    assert said in found["error"]
    assert not (tmp_path / "out").exists()


def test_usage(study, tmp_path, capsys):
    for words, message in [
        (["batch"], "the following arguments are required: STUDY"),
        (["batch", study], "the following arguments are required: --out"),
        (["batch", "none.toml", "--out", "out"], "there is no file none.toml"),
        (["batch", study, "--out", study], "Not a directory"),
        (
            ["batch", tmp_path / "files" / "mine.py", "--out", "out"],
            "mine.py is missing or returns None",
        ),
        (["compare", "none"], "there is no file none."),
    ]:
        status, result, _ = answer(capsys, *words)
        assert status == 2, words
        assert message in result["error"]


@pytest.mark.usefixtures("press_ctrl_c")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_sigterm_say_how_to_go_on(study, capsys, monkeypatch, number):
    study.write_text(TWO_SEEDS)
    add = StoredRuns.add
    monkeypatch.setattr(
        StoredRuns,
        "add",
        lambda self, *run: (add(self, *run), run[0] == 7 and os.kill(os.getpid(), number)),
    )
    assert main(["batch", str(study), "--out", "out"]) == 128 + number
    shown = capsys.readouterr()
    assert "greybox: interrupted; `greybox batch --resume out` continues." in shown.err
    assert "2 members: 2 unfinished" in shown.out
    monkeypatch.setattr(StoredRuns, "add", add)
    status, result, _ = answer(capsys, "batch", study, "--out", "out")
    assert status == 0
    assert all(member["runs"] == 12 for member in result["members"])


def test_a_study_that_its_time_limit_ends_goes_on(study, capsys):
    study.write_text(TWO_SEEDS)
    out = "erste Größe"
    status, result, message = answer(capsys, "batch", study, "--out", out, "--seconds", 1e-6)
    assert status == 1
    assert [member["status"] for member in result["members"]] == ["unfinished"] * 2
    assert result["error"].startswith("2 of 2 members have no answer: ")
    following = result["error"].split("`")[1]
    assert shlex.split(following) == ["greybox", "batch", "--resume", out]
    assert "greybox: 2 of 2 members" in message
    status, result, _ = answer(capsys, "batch", study, "--out", out, "--seconds", 1e6)
    assert status == 0
    assert all(member["status"] == "done" and member["runs"] == 12 for member in result["members"])


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (
            BlockingIOError("another process is at work in out: wait."),
            2,
            "another process is at work in out: wait.",
        ),
        (
            OSError("the disk is full."),
            1,
            "the disk is full; `greybox batch --resume out` continues.",
        ),
        (
            ExecutorLostError("the workers are gone."),
            1,
            "the workers are gone; `greybox batch --resume out` continues.",
        ),
    ],
)
def test_a_batch_that_ends_says_how_it_goes_on(study, capsys, monkeypatch, error, status, said):
    monkeypatch.setattr("greybox.cli.batch_command.batch", Mock(side_effect=error))
    study.write_text('[[member]]\nproblem = "rotors"\n')
    got, found, _ = answer(capsys, "batch", study, "--out", "out")
    assert (got, found["error"]) == (status, said)


def test_the_status_tells_a_study_that_runs_from_one_that_ended(study, capsys):
    study.write_text(TWO_SEEDS)
    answer(capsys, "batch", study, "--out", "out", "--seconds", 1e-6)
    with locked(Path("out")):
        status, result, _ = answer(capsys, "batch", "--status", "out")
        assert (status, result["running"]) == (0, True)
        assert main(["batch", "--status", "out"]) == 0
        assert "a process is working on it now" in capsys.readouterr().out
    status, result, _ = answer(capsys, "batch", "--status", "out")
    assert (status, result["running"]) == (0, False)
    assert main(["batch", "--status", "out"]) == 0
    shown = capsys.readouterr().out
    assert "no process is working on it: `greybox batch --resume out` continues" in shown


def test_a_check_finds_what_is_damaged_and_resuming_makes_it_again(study, capsys):
    study.write_text(TWO_SEEDS)
    _, result, message = answer(capsys, "batch", study, "--out", "out")
    whole = result["members"]
    assert message.startswith("2 members, at most 24 starts\n")
    assert answer(capsys, "batch", "--check", "out")[0] == 0
    with closing(sqlite3.connect("out/study.sqlite")) as database, database:
        database.execute("UPDATE members SET fit = substr(fit, 5) WHERE id = 1")
    status, result, message = answer(capsys, "batch", "--check", "out")
    assert status == 1
    assert [member["status"] for member in result["members"]] == ["unfinished", "done"]
    assert "removed 1 damaged answer" in message
    assert "--resume out` continues" in message
    status, result, _ = answer(capsys, "batch", study, "--out", "out")
    assert status == 0
    for member, wanted in zip(result["members"], whole, strict=True):
        assert member["answer"]["estimate"] == wanted["answer"]["estimate"]


def test_a_check_sets_a_damaged_database_aside_and_resuming_makes_its_members_again(study, capsys):
    study.write_text('starts = 2\n[[member]]\nproblem = "mine.py:small"\n')
    whole = answer(capsys, "batch", study, "--out", "out")[1]["members"]
    damaged = b"garbage" + Path("out/study.sqlite").read_bytes()[7:]
    Path("out/study.sqlite").write_bytes(damaged)
    status, result, message = answer(capsys, "batch", "--check", "out")
    assert status == 1
    assert "kept as study.damaged" in message
    assert "`greybox batch --resume out` continues" in result["error"]
    assert Path("out/study.damaged").read_bytes() == damaged
    del sys.modules["mine"]  # a new process has none
    status, result, _ = answer(capsys, "batch", "--resume", "out")
    assert status == 0
    assert result["members"][0]["answer"]["estimate"] == whole[0]["answer"]["estimate"]


def test_the_folder_of_a_program_has_no_study_file_to_resume(tmp_path, capsys):
    status, result, _ = answer(capsys, "batch", "--resume", tmp_path)
    assert status == 2
    assert "no study file: run the command or the program" in result["error"]


def test_a_study_resumes_where_its_folder_is_moved(study, capsys, tmp_path):
    here = study.parent
    flights = tmp_path / "flights"
    flights.mkdir()
    lines = [f"{w},{3 / (1 + w * w)},{-3 * w / (1 + w * w)}" for w in (0.5, 1.0, 2.0, 4.0, 8.0)]
    table = "\n".join(["omega_rad_s,alpha,beta", *lines, ""])
    (flights / "bode.csv").write_text(table)
    study.write_text(TWO_SEEDS + '[[member]]\nmodel = "mine.py:Lag"\ndata = "../flights/*.csv"\n')
    words = ("--out", "out", "--seconds", 1e-6, "--starts", 6)
    status, result, _ = answer(capsys, "batch", study, *words)
    assert status == 1
    moved = tmp_path / "elsewhere" / "study"
    shutil.copytree("out", moved)
    for folder in (here, flights, "out"):
        shutil.rmtree(folder)
    del sys.modules["mine"]

    status, result, _ = answer(capsys, "batch", "--resume", moved)
    assert status == 0
    assert [(m["status"], m["runs"]) for m in result["members"]] == [("done", 6)] * 3
    # More starts are stored: the study then resumes with them.
    answer(capsys, "batch", "--resume", moved, "--starts", 8)
    status, result, _ = answer(capsys, "batch", "--resume", moved)
    assert [m["runs"] for m in result["members"]] == [8] * 3
    assert not any(str(here).encode() in path.read_bytes() for path in moved.rglob("*.*"))


def test_too_many_starts_of_a_member_do_not_stop_the_rest(study, capsys):
    study.write_text(TWO_SEEDS.replace("12", "[1e12, 4]"))
    status, found, _ = answer(capsys, "batch", study, "--out", "out")
    assert status == 1
    failures = {m["name"]: m["error"] for m in found["members"] if m["status"] == "failed"}
    assert len(failures) == len(found["members"]) / 2
    assert all("give at most" in error for error in failures.values())


@pytest.fixture
def of_another_user(study, capsys, monkeypatch, tmp_path):
    """The folder of a study that another user began."""
    study.write_text(TWO_SEEDS)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "theirs"))
    answer(capsys, "batch", study, "--out", "out", "--seconds", 1e-6)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "mine"))
    sys.modules.pop("mine", None)
    shutil.rmtree(study.parent)
    return Path("out")


def test_python_files_of_another_user_run_only_with_trust(of_another_user, capsys):
    folder = of_another_user
    model = folder / "inputs" / "mine.py"
    model.write_text(f"open('executed', 'w').close()\n{model.read_text()}")
    status, result, _ = answer(capsys, "batch", "--resume", folder)
    assert status == 2
    assert "inputs has files that your greybox batch has not put there" in result["error"]
    assert "--trust" in result["error"]
    assert not Path("executed").exists()
    status, result, _ = answer(capsys, "batch", "--resume", folder, "--trust")
    assert status == 0
    assert Path("executed").exists()
    sys.modules.pop("mine", None)
    assert answer(capsys, "batch", "--resume", folder)[0] == 0  # one's own now


def test_nothing_in_a_folder_runs_that_was_put_there_later(study, capsys):
    study.write_text(TWO_SEEDS)
    answer(capsys, "batch", study, "--out", "out")
    for name in ("numpy.py", "mine.py"):
        path = Path("out/inputs") / name
        before = path.read_text() if path.exists() else None
        path.write_text(f"open('executed', 'w').close()\n{before or ''}")
        status, result, _ = answer(capsys, "batch", "--resume", "out")
        assert status == 2
        assert "has files that" in result["error"]
        path.unlink() if before is None else path.write_text(before)
    sys.modules.pop("mine", None)
    assert answer(capsys, "batch", "--resume", "out")[0] == 0
    assert not Path("executed").exists()


@pytest.mark.parametrize(
    "text", ["", "[]", "[1, 2, 3]", '["../../mine.py", null, ""]', '["/mine.py", null, ""]', "[[["]
)
def test_a_study_file_elsewhere_is_not_run(study, capsys, text):
    study.write_text(TWO_SEEDS)
    answer(capsys, "batch", study, "--out", "out", "--seconds", 1e-6)
    Path("out/inputs/study.json").write_text(text)
    for words in ((), ("--trust",)):
        status, result, _ = answer(capsys, "batch", "--resume", "out", *words)
        assert status == 2
        assert "study.json is damaged" in result["error"]


def test_a_link_among_the_copies_leads_nowhere(study, capsys, tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "study.toml").write_text("precious")
    Path("out").mkdir()
    Path("out/inputs").symlink_to(outside)
    study.write_text(TWO_SEEDS)
    status, result, _ = answer(capsys, "batch", study, "--out", "out")
    assert status == 2
    assert "is a link" in result["error"]
    assert {p.name: p.read_text() for p in outside.iterdir()} == {"study.toml": "precious"}
