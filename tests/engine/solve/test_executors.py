"""Runs made elsewhere.

The same answer from every executor, and what becomes of workers that are killed.
"""

import math
import os
import pickle
import select
import signal
import subprocess
import sys
import textwrap
import time
from concurrent.futures import (
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from gain_and_lag import Lag
from numpy.testing import assert_array_equal
from sampled_lag import lag_problem
from threadpoolctl import threadpool_info, threadpool_limits

import greybox as gb
from greybox.engine.solve.executors import TASK_SECONDS, run_all
from greybox.engine.solve.local_solver import LocalSolver, Runner
from greybox.engine.solve.lost_workers import ExecutorLostError, WorkerLostError
from greybox.engine.solve.run_storage import Memory
from greybox.engine.solve.runs import Outcome
from greybox.engine.solve.worker_task import run_starts

pytestmark = pytest.mark.usefixtures("unjudged_file")

RESPONSE = gb.Problem(
    LagLagDelay(), measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=2)
)


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
LINE = gb.Problem(
    Line(),
    gb.Record(None, {"x": FAR, "y": 3 * FAR + 0.1 * np.random.default_rng(1).normal(size=30)}),
)
GAIN = gb.FrequencyResponse(np.array([1.0, 2, 3]), np.array([3.0, 3.1, 2.9]) + 0j, "x", "y")
PROBLEMS = {
    "response": (RESPONSE, None),
    "record": (lag_problem(samples=40), None),
    "record by IPOPT": (lag_problem(samples=40), True),
    "own criterion": (LINE + gb.Problem(Line(), GAIN, criterion=OwnLikelihood()), None),
}


class LastFirst(Executor):
    """Does its tasks when one of them is looked at, the last one first."""

    def __init__(self):
        self.tasks = []

    def submit(self, fn, /, *args, **kwargs):
        executor = self

        class Waiting(Future):
            def done(self):
                executor.work()
                return super().done()

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


def fitted(problem, executor, *, by_ipopt):
    method = gb.Collocation() if by_ipopt else None
    starts = 6 if problem is RESPONSE else 2
    return gb.fit(
        problem,
        starts,
        method=method,
        search="multistart",
        executor=executor,
        profiles=False,
        progress=False,
    )


def require_same(fit, other):
    for run, wanted in zip(fit.runs, other.runs, strict=True):
        assert_array_equal(run.start, wanted.start)
        assert_array_equal(run.estimate, wanted.estimate)
        assert (run.index, run.status, run.iterations) == (
            wanted.index,
            wanted.status,
            wanted.iterations,
        )
    assert fit.cost == other.cost
    assert fit.estimate == other.estimate
    assert fit.standard_error == other.standard_error


@pytest.mark.parametrize("which", PROBLEMS)
def test_the_answer_does_not_depend_on_who_makes_the_runs(which, workers):
    problem, by_ipopt = PROBLEMS[which]
    alone = fitted(problem, None, by_ipopt=by_ipopt)
    require_same(fitted(problem, workers, by_ipopt=by_ipopt), alone)
    require_same(fitted(problem, LastFirst(), by_ipopt=by_ipopt), alone)
    with ThreadPoolExecutor(2) as threads:
        require_same(fitted(problem, threads, by_ipopt=by_ipopt), alone)


def test_batches_on_workers_give_the_same_runs(workers):
    alone = gb.fit(RESPONSE, 80, profiles=False, progress=False)
    fit = gb.fit(RESPONSE, 80, executor=workers, profiles=False, progress=False)
    require_same(fit, alone)
    assert [run.stage for run in fit.runs] == [run.stage for run in alone.runs]


def test_more_starts_than_one_batch_go_to_workers(workers):
    omega = np.array([1.0, 2.0, 4.0])
    problem = gb.Problem(Lag(), gb.FrequencyResponse(omega, 2 / (1 + 0.4j * omega)))
    here, there = (
        gb.fit(problem, starts=1100, executor=executor, profiles=False, progress=False)
        for executor in (None, workers)
    )
    assert_array_equal(here.runs.cost, there.runs.cost)


def test_time_limits_hold_on_workers(workers):
    began = time.monotonic()
    found = gb.fit(
        RESPONSE, 100_000, search="multistart", seconds=0.2, executor=workers, progress=False
    )
    assert time.monotonic() - began < 30  # all of them take minutes
    assert 1 <= len(found.runs) < 100_000
    assert "the time limit ended the search after" in found.warnings[0]


def test_progress_counts_the_runs_in_order(workers):
    seen = []
    gb.fit(
        RESPONSE,
        40,
        search="multistart",
        executor=workers,
        progress=lambda done, count: seen.append((done, count)),
    )
    assert seen == [(k + 1, 40) for k in range(40)]


class Fragile(LocalSolver):
    """Ends the worker it is in at one of the starts.

    Always, or the first time, which a file remembers.
    """

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

    def with_problem(self, nlp):
        raise NotImplementedError


STARTS = np.arange(50.0)[:, None]


def outcomes(solver, executor):
    _, starts, found = zip(*run_all(solver, enumerate(STARTS), len(STARTS), executor), strict=True)
    assert_array_equal(starts, STARTS)
    return found


def test_of_a_pool_that_is_not_ours_the_loss_is_said():
    import multiprocessing

    with (
        ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool,
        pytest.raises(
            RuntimeError, match=r"failed, BrokenProcessPool: .* use greybox\.solve\.WorkerPool"
        ),
    ):
        outcomes(Fragile(20.0), pool)


def test_a_scheduler_that_is_lost_before_its_tasks_are_handed_out_is_not_waited_for():
    class Disconnected(Executor):
        __module__ = "distributed.cfexecutor"
        _client = SimpleNamespace(status="connecting")

        def submit(self, fn, /, *args, **kwargs):
            return Future()

    with pytest.raises(
        RuntimeError, match="the executor gave up its tasks: its workers or its scheduler are gone"
    ):
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
            from greybox.problems import rotors
            workers = gb.solve.WorkerPool(1)
            gb.fit(rotors.problem(), [{}, {}], search="multistart", executor=workers)
            """
        )
    )
    done = subprocess.run(
        [sys.executable, script],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 1
    assert done.stderr.count("another process") == 0
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
    with pytest.raises(RuntimeError, match="after shutdown"):
        gb.fit(RESPONSE, 3, search="multistart", executor=pool)


class Recorder(Executor):
    """Does its tasks at once, and notes the first numbers of their starts.

    Those with a `lost` start lose the worker.
    """

    def __init__(self, lost=None):
        self.handed, self.lost = [], lost

    def submit(self, function, /, payload, starts, *others):
        self.handed.append([int(start[0]) for start in starts])
        future = Future()
        if self.lost is not None and self.lost in starts:
            future.set_exception(WorkerLostError("lost"))
        else:
            future.set_result(function(payload, starts, *others))
        return future


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ExecutorLostError("none began"), "none began"),
        (CancelledError(), "gave up its tasks"),
        (ZeroDivisionError(""), "ZeroDivisionError: no reason given. Start"),
        (ZeroDivisionError("by\n zero."), "ZeroDivisionError: by zero. Start"),
    ],
)
def test_an_executor_that_cannot_do_its_tasks_is_named_with_the_reason(error, words):
    class Failing(Executor):
        def submit(self, *_):
            future = Future()
            future.set_exception(error)
            return future

    with pytest.raises(ExecutorLostError, match=words):
        list(run_all(Lasting(1.0), enumerate(STARTS), len(STARTS), Failing()))


class Lasting(Fragile):
    """Says that every run took so long."""

    def __init__(self, seconds, together=1):
        self.seconds, self.together = seconds, together

    def __reduce__(self):
        return Lasting, (self.seconds, self.together)

    def run(self, start):
        return Outcome(2 * start, "solved", 1, self.seconds, converged=True)


@pytest.mark.parametrize(
    ("seconds", "count", "size"),
    [
        (TASK_SECONDS / 5.5, 1001, 5),  # of the work of one task
        (10 * TASK_SECONDS, 101, 1),
        (0.0, 1001, 63),  # a sixteenth of all, rounded up
        (TASK_SECONDS / 40, 321, 20),
    ],
)
def test_a_task_has_so_much_work_and_no_more_than_a_sixteenth_of_all(seconds, count, size):
    executor = Recorder()
    starts = np.arange(float(count))[:, None]
    runs = list(run_all(Lasting(seconds), enumerate(starts), count, executor))
    assert [number for number, _, _ in runs] == [*range(count)]
    assert [len(task) for task in executor.handed[:5]] == [size] * 5
    assert [k for task in executor.handed for k in task] == [*range(1, count)]


def test_tasks_are_whole_batches_and_those_that_are_stored_are_not_made_again():
    """In threes that are run together; runs 7 to 9 are stored, and 4 alone of its batch."""
    memory = Memory()
    stored = {
        number: Outcome(np.array([2.0 * number]), "stored", 1, 0.1, converged=True)
        for number in (4, 6, 7, 8)
    }
    memory.recall = lambda number, start: stored.get(number)
    executor = Recorder()
    solver = Lasting(TASK_SECONDS / 6.5, together=3)
    starts = np.arange(99.0)[:, None]
    runs = list(run_all(solver, enumerate(starts), 99, executor, memory))
    assert executor.handed[:3] == [[3, 4, 5], [*range(9, 15)], [*range(15, 21)]]
    assert [number for number, _, _ in runs] == [*range(99)]
    assert [k for k, _, outcome in runs if outcome.status == "stored"] == [6, 7, 8]


@pytest.mark.parametrize(("solvers", "waiting"), [(5.1, 5), (0.1, 2)])  # one at work, and the next
def test_tasks_that_wait_hold_little_memory(monkeypatch, solvers, waiting):
    class Silent(Executor):
        """Has done nothing of its tasks but fails the first of them, once no more are handed out."""

        def __init__(self):
            self.futures = []

        def submit(self, *_):
            self.futures.append(Future())
            if len(self.futures) == waiting:
                self.futures[0].set_exception(ZeroDivisionError())
            return self.futures[-1]

    size = len(pickle.dumps(Lasting(1.0)))
    monkeypatch.setattr("greybox.engine.solve.executors.MOST_BYTES", int(solvers * size))
    executor = Silent()
    with pytest.raises(ExecutorLostError, match="ZeroDivisionError"):
        list(run_all(Lasting(1.0), enumerate(STARTS), len(STARTS), executor))
    assert len(executor.futures) == waiting


def test_runs_of_a_later_task_are_stored_while_an_earlier_one_is_waited_for():
    """The first task ends at the third look."""
    kept, looks, futures = [], [], []
    memory = Memory()
    memory.keep = lambda number, *_: number in kept or kept.append(number)
    late = Future()

    class Late(Recorder):
        def submit(self, *arguments):
            futures.append(super().submit(*arguments))
            return futures[-1] if len(futures) > 1 else late

    def look():
        looks.append(len(kept))
        if len(looks) == 3:
            late.set_result(futures[0].result())

    memory.write_due = look
    executor = Late()
    list(run_all(Lasting(TASK_SECONDS / 2.5), enumerate(STARTS), len(STARTS), executor, memory))
    assert sorted(kept) == [*range(50)]
    assert kept.index(3) < kept.index(1)


def test_tasks_whose_worker_was_lost_are_tried_one_by_one_in_their_order():
    executor = Recorder(lost=2.0)
    runs = list(run_all(Lasting(TASK_SECONDS / 2.5), enumerate(STARTS), len(STARTS), executor))
    assert executor.handed[0] == [1, 2]
    assert [number for number, _, _ in runs] == [*range(50)]
    assert [k for k, _, outcome in runs if outcome.status == "worker lost"] == [2]
    lost = runs[2][2]
    assert (lost.cost, lost.converged) == (np.inf, False)


BUILT = []


class Counted(Fragile):
    """Notes when it is built."""

    def __init__(self, name):
        super().__init__(-1.0)
        self.name = name

    def __reduce__(self):
        return build_counted, (self.name,)


def build_counted(name):
    BUILT.append(name)
    return Counted(name)


def test_a_worker_keeps_the_last_four_solvers():
    def serve(names):
        for name in names:
            payload = pickle.dumps(Counted(name))
            (outcome,) = run_starts(payload, STARTS[3:4], os.getpid(), math.inf)
            assert outcome.estimate[0] == 6.0
        return "".join(BUILT)

    assert serve("abcd") == "abcd"
    assert serve("abab") == "abcd"
    assert serve("ecd") == "abcdecd"  # c and d were the longest unused, one after the other
    assert serve("b") == "abcdecd"


class Threads(Runner):
    """A solver whose outcomes are the numbers of threads for matrix products."""

    def run(self, start):
        return max(library["num_threads"] for library in threadpool_info())


def test_a_worker_leaves_matrix_products_to_one_thread():
    with threadpool_limits(2, "blas"):
        outcomes = run_starts(pickle.dumps(Threads()), np.zeros((3, 1)), os.getpid(), math.inf)
    assert outcomes == [1, 1, 1]
