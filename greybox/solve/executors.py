"""Runs from many starts: one after the other in this process, or on the workers of an executor.

What travels is the solver, pickled as compiled functions and numbers without the user's classes,
and the starts; what comes back are outcomes. They are taken in the order of the starts, whoever
finishes first: the answer does not depend on the executor, on the number of workers, or on their
speed.

Dask's workers have ``MALLOC_TRIM_THRESHOLD_`` in their environment, which makes every run of IPOPT
take twice as long: memory is given back and asked for again. Start them with it and
``MALLOC_MMAP_THRESHOLD_`` at 2000000000, one thread each: ``dask worker ADDRESS --nworkers 2
--nthreads 1``.
"""

import hashlib
import math
import os
import pickle
import signal
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future
from concurrent.futures import TimeoutError as StillRunning
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from greybox.files.arrays import Array
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.solve.interruption import interrupt_noted, stop_requested
from greybox.solve.kept_runs import Memory
from greybox.solve.local_solver import Runner
from greybox.solve.outcome import INTERRUPTED, SEARCH_OVER, WORKER_LOST, Outcome
from greybox.solve.time_limits import TimeLimits, current_limits, limited, one_run
from greybox.solve.worker_pool import NoWorkerError, WorkerLostError

R = TypeVar("R")

# Work of one task, s: two hundred times what a distributed scheduler takes to hand out a task, and
# little enough for progress to be seen and for Ctrl-C to be obeyed.
TASK_SECONDS = 0.3
# Tasks that a search has at least, so that workers of unlike speed end at about the same time.
FEWEST_TASKS = 16

# Tasks that are handed out and not done yet, at most, and their solvers' bytes: a scheduler holds
# all of them.
MOST_WAITING = 128
MOST_BYTES = 1 << 28

SOLVERS_KEPT = (
    4  # by a worker, so that it serves the members of a study in turn without building anew
)
GIVEN_UP = "the executor gave up its tasks: its workers or its scheduler are gone."
LOOK = 0.1  # s, after which a search that waits for workers keeps what is done and looks whether Ctrl-C was pressed


class ExecutorLostError(RuntimeError):
    """An executor has lost its workers, or its tasks cannot be done there."""


def run_all(
    solver: Runner,
    numbered: Iterable[tuple[int, Array]],
    count: int,
    executor: Executor | None = None,
    memory: Memory | None = None,
    begins: Mapping[int, Array] = MappingProxyType({}),
) -> Iterator[tuple[int, Array, Outcome]]:
    """Give the numbers of the starts, the starts (s,) and what a run from each leaves, until a stop is requested.

    They come in the order of `numbered`, of which there are `count`. As many are run at once as the
    solver runs together; of a batch that a stop cuts short, what was finished counts. With an
    executor the first batch is run here: it tells how long they take. Runs that are in the `memory`
    are not made again. A run begins at its start, or where `begins` says for its number.

    Raises
    ------
    ExecutorLostError
        When the executor has lost its workers.
    KeptRunsError
        When the runs in the memory began elsewhere.
    """
    memory = memory or Memory()
    batches = _batches(numbered, solver.together)
    made = 0
    for batch in batches:
        if interrupt_noted() or (made and stop_requested()):
            return
        made += len(batch)
        known = _recalled(memory, batch)
        outcomes = known or _timed(
            solver, np.array([begins.get(number, start) for number, start in batch])
        )
        finished = [outcome.status not in (INTERRUPTED, SEARCH_OVER) for outcome in outcomes]
        for (number, start), outcome, is_finished in zip(batch, outcomes, finished, strict=True):
            memory.keep(number, start, outcome)
            if is_finished or not any(finished):
                yield number, start, outcome
        if known is None and executor is not None:
            yield from _on_workers(
                _Tasks(solver, batches, count - made, executor, memory, begins, outcomes)
            )
            return


def call_all(
    function: Callable[..., R],
    calls: Sequence[tuple[Any, ...]],
    executor: Executor | None,
    counted: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> list[R]:
    """Return what a function of a module gives for these arguments, in their order, each call a task of the executor.

    `counted` gives what it is given, and may count how far this is.

    Raises
    ------
    ExecutorLostError
        When the executor has lost its workers.
    """
    if executor is None:
        return [function(*arguments) for arguments in counted(calls)]
    # Pickled also for threads: CasADi's functions serve one at a time.
    payloads = [pickle.dumps((function, arguments)) for arguments in calls]
    futures = [executor.submit(_called, payload, os.getpid()) for payload in payloads]
    try:
        found = [_result(future) for future in counted(futures)]
    finally:
        for future in futures:
            future.cancel()
    if any(one is None for one in found):
        raise ExecutorLostError(
            "a worker was killed as often as it was tried: its memory may not suffice."
        )
    return [one for one in found if one is not None]


def require_executor(executor: Any) -> None:
    """Refuse what is no executor.

    Raises
    ------
    TypeError
    """
    if executor is not None and not isinstance(executor, Executor):
        raise TypeError(
            f"executor is {executor!r:.60}: give an instance such as greybox.solve.WorkerPool(2)."
        )


Batch = list[tuple[int, Array]]


def _batches(numbered: Iterable[tuple[int, Array]], size: int) -> Iterator[Batch]:
    """Divide what is numbered into lists of a size; the last may be shorter."""
    rest = iter(numbered)
    while batch := list(islice(rest, size)):
        yield batch


def _recalled(memory: Memory, batch: Batch) -> list[Outcome] | None:
    """Return what is known of a batch, if it is known as a whole.

    A part of a batch is run with all of it: the last digits of a run depend on how many are run
    together.
    """
    known = [memory.recall(number, start) for number, start in batch]
    return (
        None if any(outcome is None for outcome in known) else [o for o in known if o is not None]
    )


def _timed(solver: Runner, starts: Array) -> list[Outcome]:
    """Run a batch in the time that all of its starts have."""
    with one_run(starts=len(starts)):
        return solver.run_together(starts)


def packed(solver: Runner) -> tuple[str, bytes]:
    """Return what names a solver, the same in every process, and the solver as it travels."""
    payload = pickle.dumps(solver)
    return hashlib.sha256(payload).hexdigest(), payload


def _on_workers(tasks: "_Tasks") -> Iterator[tuple[int, Array, Outcome]]:
    """Give numbers, starts and outcomes in order."""
    try:
        while not stop_requested():
            tasks.hand_out()
            if not tasks.waiting:
                return
            if tasks.is_next_done():
                yield from tasks.next()
        # Ctrl-C: what has begun is finished.
        tasks.cancel()
        while tasks.waiting and not tasks.waiting[0].is_cancelled:
            yield from tasks.next()
    finally:
        tasks.cancel()


@dataclass
class _Task:
    """Some starts, and where their outcomes come from: a future, or runs that were kept."""

    numbers: list[int]
    starts: list[Array]
    future: Future[list[Outcome]] | None = None
    outcomes: list[Outcome] | None = None

    @property
    def is_cancelled(self) -> bool:
        return self.future is not None and self.future.cancelled()


class _Tasks:
    """The tasks of one search that are handed out, in the order of the starts; `first` are the runs that were made."""

    def __init__(
        self,
        solver: Runner,
        batches: Iterator[Batch],
        count: int,
        executor: Executor,
        memory: Memory,
        begins: Mapping[int, Array],
        first: list[Outcome],
    ) -> None:
        self.waiting: deque[_Task] = deque()
        self._packed = packed(solver)
        self._together = solver.together
        self._batches = batches
        self._executor = executor
        self._memory = memory
        self._begins = begins
        self._ahead: Batch | None = None
        self._most = min(max(MOST_BYTES // len(self._packed[1]), 2), MOST_WAITING)
        self._largest = max(math.ceil(count / FEWEST_TASKS), 1)
        self._done, self._seconds = len(first), sum(outcome.seconds for outcome in first)

    def hand_out(self) -> None:
        """Hand out tasks until enough are waiting, or none is left."""
        while len(self.waiting) < self._most and not stop_requested():
            size = max(int(TASK_SECONDS * self._done / max(self._seconds, 1e-6)), 1)
            if not self._take(min(size, self._largest)):
                return

    def _take(self, most: int) -> bool:
        """Make a task of the next batches, of at most so many starts, or of one that is known; False without any."""
        some: Batch = []
        while not some or len(some) + self._together <= most:
            batch = self._ahead or next(self._batches, None)
            self._ahead = None
            if batch is None:
                break
            known = _recalled(self._memory, batch)
            if known is not None:
                if some:
                    self._ahead = batch
                    break
                self.waiting.append(
                    _Task(
                        [number for number, _ in batch], [start for _, start in batch], None, known
                    )
                )
                return True
            some += batch
        if some:
            self.waiting.append(
                self._submitted([number for number, _ in some], [start for _, start in some])
            )
        return bool(some)

    def is_next_done(self) -> bool:
        """Wait for the first of the waiting tasks; False when a stop was requested before."""
        first = self.waiting[0]
        while not stop_requested():
            if first.outcomes is not None or first.future is None:
                return True
            try:
                first.future.exception(timeout=LOOK)
            except StillRunning:
                self._look()
                continue
            except CancelledError:
                pass
            return True
        return False

    def next(self) -> Iterator[tuple[int, Array, Outcome]]:
        """Give what the first of the waiting tasks left; where its worker was lost, its starts are tried one by one."""
        task = self.waiting.popleft()
        if task.outcomes is None:
            self._finish(task)
        if task.outcomes is None and len(task.starts) > 1:
            each = zip(reversed(task.numbers), reversed(task.starts), strict=True)
            self.waiting.extendleft([self._submitted([number], [start]) for number, start in each])
            return
        if task.outcomes is None:
            task.outcomes = [
                Outcome(task.starts[0], WORKER_LOST, 0, 0.0, converged=False, cost=math.inf)
            ]
            self._keep(task, task.outcomes)
        yield from zip(task.numbers, task.starts, task.outcomes, strict=True)

    def cancel(self) -> None:
        """Take back what has not begun."""
        for task in self.waiting:
            if task.future is not None:
                task.future.cancel()

    def _look(self) -> None:
        """Keep what is done, whatever is waited for."""
        for task in self.waiting:
            if task.outcomes is None and task.future is not None and _is_without_error(task.future):
                self._finish(task)
        self._memory.look()
        if _is_cut_off(self._executor):
            raise ExecutorLostError(GIVEN_UP)

    def _finish(self, task: _Task) -> None:
        """Take the outcomes of a task that is done, if its worker was not lost."""
        assert task.future is not None
        task.outcomes = _result(task.future)
        if task.outcomes is not None:
            self._done += len(task.outcomes)
            self._seconds += sum(outcome.seconds for outcome in task.outcomes)
            self._keep(task, task.outcomes)

    def _keep(self, task: _Task, outcomes: list[Outcome]) -> None:
        for number, start, outcome in zip(task.numbers, task.starts, outcomes, strict=True):
            self._memory.keep(number, start, outcome)

    def _submitted(self, numbers: list[int], starts: list[Array]) -> _Task:
        begins = [
            self._begins.get(number, start) for number, start in zip(numbers, starts, strict=True)
        ]
        where = (np.array(begins), os.getpid(), current_limits())
        return _Task(numbers, starts, self._executor.submit(run_starts, *self._packed, *where))


def _is_cut_off(executor: Executor) -> bool:
    """Tell whether Dask has lost its scheduler: it cancels the tasks of before, and those of after are never done."""
    if type(executor).__module__ != "distributed.cfexecutor":
        return False
    return getattr(executor, "_client").status != "running"  # noqa: B009  (of the class of a package that may be absent)


def _is_without_error(future: Future[list[Outcome]]) -> bool:
    """Tell whether a task is done and has left its outcomes."""
    return future.done() and not future.cancelled() and future.exception() is None


def _result(future: Future[R]) -> R | None:
    """Return what a task has left; None when its worker was lost and can be replaced."""
    try:
        return future.result()
    except WorkerLostError:
        return None
    except NoWorkerError as error:
        raise ExecutorLostError(str(error)) from error
    except CancelledError as error:
        raise ExecutorLostError(GIVEN_UP) from error
    except Exception as error:
        said = " ".join(str(error).split())[:300].rstrip(".") or "no reason given"
        raise ExecutorLostError(
            f"a task of the executor failed, {type(error).__name__}: {said}. Start its workers again, or use "
            "greybox.solve.WorkerPool, which replaces those that it loses."
        ) from error


# --- on the worker


class _Built(threading.local):
    """The solvers of this thread: CasADi's functions serve one at a time."""

    def __init__(self) -> None:
        self.solvers: OrderedDict[str, Runner] = OrderedDict()


_built = _Built()


def run_starts(
    key: str, payload: bytes, starts: Array, coordinator: int, limits: TimeLimits
) -> list[Outcome]:
    """Run the solver in `payload`, which `key` names, from every row of `starts` (r, p).

    `coordinator` is the number of the process that decides about Ctrl-C, `limits` are the time
    limits of its search.
    """
    solvers = _built.solvers
    with _deaf_to_interrupts(os.getpid() != coordinator), limited(limits):
        if key not in solvers:
            while len(solvers) >= SOLVERS_KEPT:
                solvers.popitem(last=False)
            solvers[key] = one_thread_at_a_time(pickle.loads)(payload)
        solvers.move_to_end(key)
        solver = solvers[key]
        batches = (
            starts[at : at + solver.together] for at in range(0, len(starts), solver.together)
        )
        return [outcome for batch in batches for outcome in _timed(solver, batch)]


def _called(payload: bytes, coordinator: int) -> Any:
    """Call the function in `payload` with its arguments; see `run_starts` for `coordinator`."""
    with _deaf_to_interrupts(os.getpid() != coordinator):
        function, arguments = pickle.loads(payload)
        return function(*arguments)


@contextmanager
def _deaf_to_interrupts(applies: bool) -> Iterator[None]:
    """Ignore Ctrl-C within, which a terminal sends to the workers as well."""
    if not applies or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
