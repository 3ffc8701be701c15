"""Batches: what is kept, what goes on, and what is refused."""

import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, nullcontext
from importlib import import_module
from pathlib import Path
from threading import Timer, current_thread, main_thread

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from filelock import FileLock
from numpy.testing import assert_array_equal
from sampled_lag import lag_problem

import greybox as gb
from greybox.assessment.fit import SolverChoice, fingerprint, fit_with_storage
from greybox.workflows.study.members import read_members
from greybox.workflows.study.running import is_running
from greybox.workflows.study.stored_runs import StoredRuns
from greybox.workflows.study.study_lock import locked

pytestmark = pytest.mark.usefixtures("unjudged_file")

RESPONSE = gb.Problem(
    LagLagDelay(), measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=2)
)
OTHER = gb.Problem(
    LagLagDelay(), measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=3)
)


def members(starts=6):
    return [
        gb.study.Member(RESPONSE, starts, name="response", search="multistart"),
        gb.study.Member(lag_problem(), 2, name="record"),
        gb.study.Member(RESPONSE, starts, seed=1, name="other seed", search="multistart"),
    ]


def require_same(fit, other):
    assert len(fit.runs) == len(other.runs)
    for run, wanted in zip(fit.runs, other.runs, strict=True):
        assert_array_equal(run.start, wanted.start)
        assert_array_equal(run.estimate, wanted.estimate)
        assert (run.status, run.iterations, run.cost) == (
            wanted.status,
            wanted.iterations,
            wanted.cost,
        )
    assert fit.cost == other.cost
    assert fit.estimate == other.estimate
    assert fit.standard_error == other.standard_error


@pytest.fixture
def made(monkeypatch):
    """The numbers of the starts from which runs are made, in their order."""
    numbers = []
    add = StoredRuns.add

    def noted(self, number, start, outcome):
        if number >= 0:  # the others are the solver's own idea
            numbers.append(number)
        add(self, number, start, outcome)

    monkeypatch.setattr(StoredRuns, "add", noted)
    return numbers


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a batch that is done."""
    folder = tmp_path_factory.mktemp("finished")
    gb.batch(members(), folder, progress=False)
    return folder


def test_members_are_the_fits_that_gb_fit_makes(finished):
    study = gb.study.read_study(finished)
    assert [member.status for member in study.members] == ["done"] * 3
    for member, stated in zip(study.members, members(), strict=True):
        require_same(
            member.fit,
            gb.fit(
                stated.problem, stated.starts, stated.seed, search=stated.search, progress=False
            ),
        )
    assert study["record"].fit.parts[0].data.checksum == lag_problem().data.checksum
    assert re.search("other seed .* done ", str(study))


@pytest.mark.parametrize("limit", [1000.0, 1e-9], ids=["small", "large"])
def test_workers_fit_whole_members_while_these_are_small(tmp_path, monkeypatch, finished, limit):
    in_main_thread, finish = [], StoredRuns.finish

    def noted(self, *values):
        in_main_thread.append(current_thread() is main_thread())
        finish(self, *values)

    monkeypatch.setattr(StoredRuns, "finish", noted)
    monkeypatch.setattr(import_module("greybox.workflows.study.batch"), "UNWRITTEN", limit)
    with ThreadPoolExecutor(2) as workers:
        gb.batch(members(), tmp_path, executor=workers, progress=False)
    # The first is fitted here, which shows whether members are small.
    assert sorted(in_main_thread) == ([False, False, True] if limit > 1 else [True] * 3)
    times = {"seconds": 0, "finished": 0}
    for member, expected in zip(read_members(tmp_path), read_members(finished), strict=True):
        assert {**member.answer, **times} == {**expected.answer, **times}
        require_same(member.fit, expected.fit)


def test_what_is_done_is_not_made_again(tmp_path, made, finished):
    first = gb.study.read_study(finished)
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    database = (tmp_path / "study.sqlite").read_bytes()
    again = gb.batch(members(), tmp_path, progress=False)
    assert made == []
    assert (tmp_path / "study.sqlite").read_bytes() == database
    assert str(again).splitlines()[1:] == str(first).splitlines()[1:]


def test_a_finished_member_is_not_compiled_unless_it_may_have_changed(tmp_path, monkeypatch):
    problems = [lag_problem(seed) for seed in range(3)]
    stated = [gb.study.Member(p, 2, name=f"record {k}") for k, p in enumerate(problems)]
    gb.batch(stated, tmp_path, progress=False)
    compiled, compile_it = [], SolverChoice.solver

    def noted(self, problem):
        compiled.append(problem)
        return compile_it(self, problem)

    monkeypatch.setattr(SolverChoice, "solver", noted)
    gb.batch(stated, tmp_path, progress=False)
    assert compiled == problems[:1]
    changed = problems[2].with_(bounds={"K": (0.5, 9.0)})
    stated[2] = gb.study.Member(changed, 2, name="record 2")
    with pytest.raises(ValueError, match="belongs to another problem"):
        gb.batch(stated, tmp_path, progress=False)


class Gained(gb.TransferFunction):
    """A lag with a known gain, which notes when its formula is traced."""

    T = gb.Parameter(1.0, bounds=(0.1, 5))
    gains_traced = []

    def __init__(self, gain):
        self.gain = gain

    def response(self, s, p):
        if not isinstance(p.T, float):
            self.gains_traced.append(self.gain)
        return self.gain / (p.T * s + 1)


@pytest.mark.parametrize("workers", [0, 2])
def test_equal_models_of_a_study_are_traced_once(tmp_path, workers):
    """The gains differ, and so do the data of members with equal ones."""
    omega = np.array([0.3, 0.6, 1.0, 2.0, 4.0])
    members = [
        gb.study.Member(
            gb.Problem(Gained(gain), gb.FrequencyResponse(omega, gain / (T * 1j * omega + 1))),
            2,
            name=f"{gain} {T}",
        )
        for T in (0.5, 0.8, 1.1)
        for gain in (1.0, 3.0)
    ]
    Gained.gains_traced.clear()
    with ThreadPoolExecutor(workers) if workers else nullcontext() as executor:
        study = gb.batch(members, tmp_path, executor=executor, progress=False)
    threads = max(workers, 1) + bool(workers)
    assert 2 <= len(Gained.gains_traced) <= 2 * threads
    for member in study.members:
        assert member.answer["estimate"]["T"] == pytest.approx(float(member.name.split()[1]))
    # A study that is stated later traces again: a model may have changed in between.
    count = len(Gained.gains_traced)
    gb.batch(members[:1], tmp_path / "later", progress=False)
    assert len(Gained.gains_traced) == count + 1


@pytest.mark.parametrize(
    ("damage", "missing"), [("answer and run", [3]), ("fit", []), ("database", [*range(6)])]
)
def test_what_is_damaged_is_made_again_and_nothing_else(tmp_path, made, finished, damage, missing):
    first = members()[:1]
    whole = gb.study.read_study(finished)["response"].fit
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    database = tmp_path / "study.sqlite"
    if damage == "answer and run":
        with closing(sqlite3.connect(database)) as connection, connection:
            connection.execute("UPDATE members SET answer = answer || 'x' WHERE id = 1")
            connection.execute("UPDATE runs SET run = '' WHERE member = 1 AND number = 3")
    elif damage == "fit":
        with closing(sqlite3.connect(database)) as connection, connection:
            connection.execute("UPDATE members SET fit = NULL WHERE id = 1")
    else:
        database.write_bytes(b"\xff" * 5000)
    with pytest.warns(UserWarning, match="what is missing is computed again"):
        study = gb.batch(first, tmp_path, progress=False)
    assert made == missing
    require_same(study["response"].fit, whole)


def test_more_starts_keep_the_old_ones(tmp_path, made, finished):
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    study = gb.batch(members(10), tmp_path, progress=False)
    assert made == 2 * list(range(6, 10))
    require_same(study["response"].fit, gb.fit(RESPONSE, 10, search="multistart", progress=False))


def test_more_members_join_those_in_the_folder(tmp_path, made):
    gb.batch(members()[:1], tmp_path, progress=False)
    made.clear()
    study = gb.batch(members()[1:2], tmp_path, progress=False)
    assert [member.name for member in study.members] == ["response", "record"]
    assert len(made) == 2


def test_a_member_that_fails_does_not_stop_the_rest(tmp_path):
    bad = gb.study.Member(RESPONSE, [{"none": 1.0}], name="bad")
    study = gb.batch([bad, *members()[:1]], tmp_path, progress=False)
    assert [member.status for member in study.members] == ["failed", "done"]
    assert "none" in study["bad"].error
    assert f"bad      {study['bad'].error}" in str(study)
    mended = gb.batch(
        [gb.study.Member(RESPONSE, 5, name="bad"), *members()[:1]], tmp_path, progress=False
    )
    assert [member.status for member in mended.members] == ["done", "done"]


class Huge(gb.solve.Starts):
    """A rule that needs more memory than there is."""

    def draw(self, parameters):
        """Fail as numpy does."""
        raise MemoryError

    def __str__(self):
        return "huge"


def test_too_many_starts_or_too_little_memory_end_their_member_only(tmp_path):
    listed = [
        gb.study.Member(RESPONSE, Huge(), name="huge"),
        gb.study.Member(RESPONSE, 10**12, name="many"),
        *members()[:1],
    ]
    study = gb.batch(listed, tmp_path, progress=False)
    assert [member.status for member in study.members] == ["failed", "failed", "done"]
    assert study["huge"].error.startswith("test_batch.py, line ")
    assert study["huge"].error.endswith(": MemoryError")
    assert "give at most 1048576" in study["many"].error


def test_another_problem_under_the_same_name_is_refused_and_changes_nothing(tmp_path):
    gb.batch(members()[:1], tmp_path, progress=False)
    files = {path: path.read_bytes() for path in tmp_path.rglob("*.*")}
    with pytest.raises(
        ValueError, match="the answer of 'response' in this study belongs to another"
    ):
        gb.batch([gb.study.Member(OTHER, 6, name="response")], tmp_path, progress=False)
    other = StoredRuns(tmp_path, "response")
    with pytest.raises(ValueError, match="belong to another problem"):
        other.stored(fingerprint(OTHER, SolverChoice()))
    with pytest.raises(ValueError, match="began at other starts, from number 1 on"):
        gb.batch(
            [gb.study.Member(RESPONSE, 6, seed=5, name="response", search="multistart")],
            tmp_path,
            progress=False,
        )
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.*")} == files


def test_what_is_no_study_is_said(tmp_path):
    with pytest.raises(FileNotFoundError, match="is not a study"):
        gb.study.read_study(tmp_path)
    with pytest.raises(ValueError, match="2 members have the name"):
        gb.batch([RESPONSE, RESPONSE], tmp_path)
    with pytest.raises(ValueError, match="members is empty"):
        gb.batch([], tmp_path)
    with pytest.raises(TypeError, match="give a Problem"):
        gb.batch([3], tmp_path)
    with pytest.raises(TypeError, match="give a list of problems"):
        gb.batch(RESPONSE, tmp_path)
    assert list(tmp_path.iterdir()) == []


# --- processes that are killed

SCRIPT = """
import sys, time
sys.path[:0] = {paths!r}
import greybox as gb
from greybox.engine.solve.response_solver import ResponseSolver
from greybox.workflows.study import stored_runs
from test_batch import members

run = ResponseSolver.run
def slow(self, start, *others):
    time.sleep(0.3)
    return run(self, start, *others)
ResponseSolver.run = slow
stored_runs.UNWRITTEN = 0.2

if __name__ == "__main__":
    workers = gb.solve.WorkerPool(2) if {workers} else None
    gb.batch(members(), sys.argv[1], executor=workers, progress=False)
"""


@contextmanager
def at_work(tmp_path, folder, *, workers):
    """A process that makes the batch until runs of its own are on disk, and is killed at the end."""
    here, before = Path(__file__).parent, kept(folder)
    paths = [str(here), str(here.parents[1] / "support")]
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(paths=paths, workers=workers))
    with subprocess.Popen([sys.executable, script, folder]) as process:
        while kept(folder) <= before and process.poll() is None:
            time.sleep(0.05)
        yield
        process.kill()
    assert process.returncode == -signal.SIGKILL
    assert kept(folder) > before


def test_a_killed_batch_resumes_and_refuses_a_second_writer(tmp_path, monkeypatch, finished):
    folder = tmp_path / "study"
    with at_work(tmp_path, folder, workers=False):
        with monkeypatch.context() as hasty:
            hasty.setattr("greybox.workflows.study.study_lock.PATIENCE", 0.1)
            with pytest.raises(BlockingIOError, match="another process is writing to"):
                gb.batch(members(), folder, progress=False)
        assert len(gb.study.read_study(folder).members) == 3  # reading is free
        assert is_running(folder)
    assert is_running(folder) is False  # killed, it could not say so
    with at_work(tmp_path, folder, workers=True):
        pass
    study = gb.batch(members(), folder, progress=False)
    for member, expected in zip(study.members, read_members(finished), strict=True):
        require_same(member.fit, expected.fit)


def test_a_lock_that_is_let_go_in_a_moment_is_waited_for(tmp_path):
    lock = FileLock(tmp_path / "lock", thread_local=False)
    lock.acquire()
    Timer(0.3, lock.release).start()
    with locked(tmp_path):
        assert not lock.is_locked


def kept(folder):
    """How many runs are on disk."""
    try:
        return sum(member.runs for member in read_members(folder))
    except (FileNotFoundError, ValueError):  # there are no tables yet
        return 0


def test_ctrl_c_keeps_what_was_done(tmp_path, monkeypatch, press_ctrl_c, made, finished):
    add = StoredRuns.add

    def press(self, number, start, outcome):
        add(self, number, start, outcome)
        if sum(at == number for at in made) == 2 and number == 4:
            press_ctrl_c()

    monkeypatch.setattr(StoredRuns, "add", press)
    with pytest.raises(KeyboardInterrupt) as stopped:
        gb.batch(members(), tmp_path, progress=False)
    assert [member.status for member in stopped.value.study.members] == [
        "done",
        "done",
        "unfinished",
    ]
    assert stopped.value.study["other seed"].runs == 5
    monkeypatch.undo()
    study = gb.batch(members(), tmp_path, progress=False)
    require_same(study["other seed"].fit, gb.study.read_study(finished)["other seed"].fit)


@pytest.mark.skipif(sys.platform == "win32", reason="limits of the size of files are those of Unix")
def test_a_full_disk_is_a_sentence_and_the_batch_goes_on(tmp_path, finished):
    from full_disk import limited_files

    with (
        limited_files(8000),
        pytest.raises(OSError, match=r"cannot be written"),
    ):
        gb.batch(members(), tmp_path, progress=False)
    study = gb.batch(members(), tmp_path, progress=False)
    require_same(study["response"].fit, gb.study.read_study(finished)["response"].fit)


@pytest.mark.parametrize(
    "problem",
    [lag_problem(), lag_problem() + lag_problem(1), RESPONSE],
    ids=["record", "two", "response"],
)
def test_runs_of_every_kind_come_back_as_they_were(tmp_path, problem):
    found = {}

    class Noted(StoredRuns):
        def add(self, number, start, outcome):
            found[number] = start, outcome
            super().add(number, start, outcome)

    kept = Noted(tmp_path, "fit")
    fit = fit_with_storage(kept, problem, 4, by=SolverChoice(), progress=False)
    kept.write()
    known = StoredRuns(tmp_path, "fit").stored(fingerprint(problem, SolverChoice()))
    assert sorted(known) == sorted(found) == [0, 1, 2, 3]
    for number, (start, outcome) in known.items():
        assert_array_equal(start, found[number][0])
        wanted = found[number][1]
        for name in ("status", "iterations", "seconds", "converged"):
            assert getattr(outcome, name) == getattr(wanted, name)
        assert_array_equal(outcome.cost, wanted.cost)
        assert_array_equal(outcome.estimate, wanted.estimate)
        assert (outcome.signature is None) == (wanted.signature is None) == (problem is RESPONSE)
        for array, other in zip(outcome.nodes or (), wanted.nodes or (), strict=True):
            assert_array_equal(array, other)
    found.clear()
    require_same(
        fit_with_storage(Noted(tmp_path, "fit"), problem, 4, by=SolverChoice(), progress=False), fit
    )
    assert found == {}


def test_an_error_in_the_model_of_a_member_names_file_and_line(tmp_path):
    class Misspelled(gb.StateSpace):
        states, inputs, outputs = ("x",), ("u",), ("x",)
        K = gb.Parameter(1.0)

        def derivative(self, x, u, p):
            return (p.K * u.u - x.y,)

        def output(self, x, u, p):
            return (x.x,)

    time = [0.1 * k for k in range(20)]
    problem = gb.Problem(Misspelled(), gb.Record(time, {"u": time, "x": time}), name="misspelled")
    study = gb.batch([problem], tmp_path, progress=False)
    line = Misspelled.derivative.__code__.co_firstlineno + 1
    wrong = "AttributeError: Misspelled.states has no 'y'; it has x."
    assert study["misspelled"].error == f"test_batch.py, line {line}: {wrong}"
