"""Runs made elsewhere: the same answer from every executor, and what becomes of workers that are killed."""

import os
import select
import signal
import subprocess
import sys
import textwrap
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from numpy.testing import assert_array_equal
from sampled_lag import lag_problem

import greybox as gb
from greybox.solve.executors import run_all
from greybox.solve.local_solver import LocalSolver
from greybox.solve.outcome import Outcome
from greybox.solve.worker_pool import _single_threads

RESPONSE = gb.Problem(LagLagDelay(), measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=2))


class Line(gb.StateSpace):
    """Far from its intercept, so that the last steps need more digits."""

    states, inputs, outputs = (), ("x",), ("y",)
    a = gb.Parameter(0.0, bounds=(-1e9, 1e9))
    b = gb.Parameter(0.0, bounds=(-1e3, 1e3))

    def output(self, x, u, p):
        return (p.a + p.b * u.x,)


class OwnLikelihood(gb.RelativeLikelihood):
    """A criterion that other processes do not know."""


FAR = 1e6 + np.linspace(-0.5, 0.5, 30)
LINE = gb.Problem(Line(), gb.Record(None, {"x": FAR, "y": 3 * FAR + 0.1 * np.random.default_rng(1).normal(size=30)}))
GAIN = gb.FrequencyResponse(np.array([1.0, 2, 3]), np.array([3.0, 3.1, 2.9]) + 0j, "x", "y")
PROBLEMS = {
    "response": (RESPONSE, None),
    "record": (lag_problem(), None),
    "record by IPOPT": (lag_problem(), True),
    "line": (LINE, None),
    "line and response": (LINE + gb.Problem(Line(), GAIN), None),
    "own criterion": (LINE + gb.Problem(Line(), GAIN, criterion=OwnLikelihood()), None),
}


class LastFirst(Executor):
    """Does its tasks when the first of them is waited for, the last one first."""

    def __init__(self):
        self.tasks = []

    def submit(self, fn, /, *args, **kwargs):
        executor = self

        class Waiting(Future):
            def exception(self, timeout=None):
                executor.work()
                return super().exception(timeout)

        future = Waiting()
        self.tasks.append((future, fn, args, kwargs))
        return future

    def work(self):
        while self.tasks:
            future, fn, args, kwargs = self.tasks.pop()
            if future.set_running_or_notify_cancel():
                future.set_result(fn(*args, **kwargs))


@pytest.fixture(scope="module")
def workers():
    with gb.solve.WorkerPool(2) as pool:
        yield pool


@pytest.fixture(scope="module")
def lone_worker():
    """Has a task and the next one: with it, both are lost."""
    with gb.solve.WorkerPool(1) as pool:
        yield pool


def fitted(problem, executor, *, by_ipopt):
    method = gb.Collocation() if by_ipopt else None
    starts = 40 if problem is RESPONSE else 2 if by_ipopt else 4
    return gb.fit(problem, starts, method=method, search="multistart", executor=executor, progress=False)


def require_same(fit, other):
    for run, wanted in zip(fit.runs, other.runs, strict=True):
        assert_array_equal(run.start, wanted.start)
        assert_array_equal(run.estimate, wanted.estimate)
        assert (run.index, run.status, run.iterations) == (wanted.index, wanted.status, wanted.iterations)
    assert fit.cost == other.cost
    assert fit.estimate == other.estimate
    assert fit.standard_error == other.standard_error


@pytest.mark.parametrize("which", PROBLEMS)
def test_the_answer_does_not_depend_on_who_makes_the_runs(which, workers):
    problem, by_ipopt = PROBLEMS[which]
    alone = fitted(problem, None, by_ipopt=by_ipopt)
    require_same(fitted(problem, workers, by_ipopt=by_ipopt), alone)
    require_same(fitted(problem, LastFirst(), by_ipopt=by_ipopt), alone)
    with ThreadPoolExecutor(3) as threads:
        require_same(fitted(problem, threads, by_ipopt=by_ipopt), alone)


def test_batches_on_workers_give_the_same_runs(workers, monkeypatch):
    monkeypatch.setattr("greybox.solve.batched_solver.MOST", 64)
    alone = gb.fit(RESPONSE, 200, progress=False)
    fit = gb.fit(RESPONSE, 200, executor=workers, progress=False)
    require_same(fit, alone)
    assert [run.stage for run in fit.runs] == [run.stage for run in alone.runs]


def test_time_limits_hold_on_workers(workers):
    began = time.monotonic()
    found = gb.fit(RESPONSE, 100_000, search="multistart", seconds=0.5, executor=workers, progress=False)
    assert time.monotonic() - began < 30  # all of them take minutes
    assert 1 <= len(found.runs) < 100_000
    assert "the time limit ended the search after" in found.warnings[0]
    cut = gb.fit(RESPONSE, 40, search="multistart", start_seconds=1e-9, executor=workers, progress=False)
    assert [run.status for run in cut.runs] == ["time limit of a start"] * 40


def test_progress_counts_the_runs_in_order(workers):
    seen = []
    gb.fit(RESPONSE, 40, search="multistart", executor=workers, progress=lambda done, count: seen.append((done, count)))
    assert seen == [(k + 1, 40) for k in range(40)]


class Fragile(LocalSolver):
    """Ends the worker it is in at one of the starts: always, or the first time, which a file remembers."""

    def __init__(self, deadly, file=None):
        self.deadly, self.file = deadly, file

    def __reduce__(self):
        return Fragile, (self.deadly, self.file)

    def run(self, start):
        if start[0] == self.deadly and (self.file is None or not Path(self.file).exists()):
            if self.file is not None:
                Path(self.file).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return Outcome(2 * start, "solved", 1, 1e-3, converged=True)

    def profile(self, x, nodes=None):
        raise NotImplementedError

    def cost(self, values):
        raise NotImplementedError

    def refined(self, nlp):
        raise NotImplementedError


STARTS = np.arange(50.0)[:, None]


def outcomes(solver, executor):
    _, starts, found = zip(*run_all(solver, enumerate(STARTS), len(STARTS), executor), strict=True)
    assert_array_equal(starts, STARTS)
    return found


def test_a_worker_that_is_killed_is_replaced(tmp_path, lone_worker):
    found = outcomes(Fragile(20.0, str(tmp_path / "seen")), lone_worker)
    assert (tmp_path / "seen").exists()
    assert_array_equal([outcome.estimate for outcome in found], 2 * STARTS)


def test_a_start_that_always_ends_its_worker_is_a_run_that_failed(lone_worker, monkeypatch):
    monkeypatch.setattr("greybox.solve.worker_pool.TRIALS", 2)
    found = outcomes(Fragile(20.0), lone_worker)
    assert [k for k, outcome in enumerate(found) if outcome.status == "worker lost"] == [20]
    assert not found[20].converged
    assert all(outcome.status == "solved" for k, outcome in enumerate(found) if k != 20)


def test_of_a_pool_that_is_not_ours_the_loss_is_said():
    import multiprocessing

    with (
        ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool,
        pytest.raises(RuntimeError, match=r"failed, BrokenProcessPool: .* use greybox\.solve\.WorkerPool"),
    ):
        outcomes(Fragile(20.0), pool)


def test_a_scheduler_that_is_lost_before_its_tasks_are_handed_out_is_not_waited_for():
    class Disconnected(Executor):
        __module__ = "distributed.cfexecutor"
        _client = SimpleNamespace(status="connecting")

        def submit(self, fn, /, *args, **kwargs):
            return Future()

    with pytest.raises(RuntimeError, match="the executor gave up its tasks: its workers or its scheduler are gone"):
        gb.fit(RESPONSE, 20, search="multistart", executor=Disconnected(), progress=False)


def test_ctrl_c_keeps_the_runs_that_were_made(press_ctrl_c, workers):
    def progress(done, _):
        if done == 30:
            press_ctrl_c()

    with pytest.raises(KeyboardInterrupt) as stopped:
        gb.fit(RESPONSE, 20_000, search="multistart", executor=workers, progress=progress)
    runs = stopped.value.fit.runs
    assert 30 <= len(runs) < 20_000
    assert all(run.status != "interrupted" for run in runs)
    again = gb.fit(RESPONSE, 8, search="multistart", executor=workers)  # the workers are as before
    assert again.converged


def test_workers_end_with_the_process_that_started_them(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        textwrap.dedent(
            """
            import os, time
            import greybox as gb
            if __name__ == "__main__":
                with gb.solve.WorkerPool(1) as workers:
                    print(workers.submit(os.getpid).result(), flush=True)
                    time.sleep(300)
            """
        )
    )
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as process:
        assert int(process.stdout.readline()) != process.pid
        process.kill()
        # The worker holds the other end of the pipe: it is closed when the last of both ends.
        assert select.select([process.stdout], [], [], 60)[0]
        assert process.stdout.read() == ""


def test_a_script_without_its_guard_is_told_what_is_missing(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        textwrap.dedent(
            """
            import greybox as gb
            with gb.solve.WorkerPool(1) as workers:
                workers.submit(print).result()
            """
        )
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 1
    assert "no worker process could begin: in a script" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize("number", [0, -1, 1.5, True, "2"])
def test_a_number_of_workers_that_is_none(number):
    with pytest.raises(ValueError, match="workers is"):
        gb.solve.WorkerPool(number)


def test_what_is_no_executor_is_refused():
    with pytest.raises(TypeError, match="executor is 2: give an instance"):
        gb.fit(RESPONSE, 3, executor=2)
    pool = gb.solve.WorkerPool(1)
    pool.shutdown()
    with pytest.raises(RuntimeError, match="was shut down"):
        gb.fit(RESPONSE, 3, search="multistart", executor=pool)


def test_workers_have_one_thread_unless_the_environment_says_more(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with _single_threads():
        assert (os.environ["OMP_NUM_THREADS"], os.environ["MKL_NUM_THREADS"]) == ("3", "1")
    assert os.environ["OMP_NUM_THREADS"] == "3"
    assert "MKL_NUM_THREADS" not in os.environ


def test_a_search_is_cut_into_enough_tasks_for_workers_of_unlike_speed(monkeypatch):
    """Of 40 quick starts each task has a sixteenth, rounded up; the first is run before any is handed out."""
    monkeypatch.setattr("greybox.solve.executors.TASK_SECONDS", 1e6)
    executor, tasks = LastFirst(), []
    submit = executor.submit
    executor.submit = lambda *words, **more: tasks.append(words) or submit(*words, **more)
    fitted(RESPONSE, executor, by_ipopt=False)
    assert len(tasks) == 13
