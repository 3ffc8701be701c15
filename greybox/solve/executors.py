"""Runs from many starts: one after the other in this process, or on the workers of an executor.

Begin with `run_all`. A worker receives the solver, pickled as compiled functions and numbers
without the user's classes, and starts; it returns outcomes. They are taken in the order of the
starts, whichever finishes first: the answer does not depend on the executor, on the number of
workers, or on their speed.

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
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future
from concurrent.futures import TimeoutError as StillRunning
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from types import MappingProxyType
from typing import Any

import numpy as np

from greybox.files.arrays import Array
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.solve.interruption import (
    TimeLimits,
    current_limits,
    interrupt_noted,
    limited,
    one_run,
    stop_requested,
)
from greybox.solve.kept_runs import Memory
from greybox.solve.local_solver import Runner
from greybox.solve.runs import INTERRUPTED, SEARCH_OVER, WORKER_LOST, Outcome
from greybox.solve.worker_pool import NoWorkerError, WorkerLostError

Batch = list[tuple[int, Array]]

# Work of one task, s: two hundred times the overhead of a distributed scheduler, and short enough
# to show progress and to obey Ctrl-C.
TASK_SECONDS = 0.3
# Tasks that are handed out and not done yet, at most, and their solvers' bytes: a scheduler holds
# all of them.
MOST_WAITING = 128
MOST_BYTES = 1 << 28

LOST = "the executor gave up its tasks: its workers or its scheduler are gone."


class ExecutorLostError(RuntimeError):
    """An executor has lost its workers, or they cannot do its tasks."""


def run_all(
    solver: Runner,
    numbered: Iterable[tuple[int, Array]],
    count: int,
    executor: Executor | None = None,
    memory: Memory | None = None,
    begins: Mapping[int, Array] = MappingProxyType({}),
) -> Iterator[tuple[int, Array, Outcome]]:
    """Yield (number, start, outcome) for every run, until a stop is requested.

    The runs come in the order of the `count` starts (s,) in `numbered`. As many are made at once as
    the solver runs together; if a stop cuts a batch short, its finished runs count. With an
    executor the first batch is run here to measure how long a run takes. Runs in the `memory` are
    not made again. A run begins at its start, or where `begins` says for its number.

    Raises
    ------
    ExecutorLostError
        If the executor has lost its workers.
    KeptRunsError
        If the runs in the memory began elsewhere.
    """
    memory = memory or Memory()
    batches = _batches(numbered, solver.together)
    remaining = count
    for batch in batches:
        if interrupt_noted() or (remaining < count and stop_requested()):
            return
        remaining -= len(batch)

        # The first batch is run here: its time decides the size of the tasks.
        recalled = _recalled(memory, batch)
        outcomes = recalled or _run(
            solver, np.array([begins.get(number, start) for number, start in batch])
        )
        finished = [outcome.status not in (INTERRUPTED, SEARCH_OVER) for outcome in outcomes]
        for (number, start), outcome, is_finished in zip(batch, outcomes, finished, strict=True):
            memory.keep(number, start, outcome)
            if is_finished or not any(finished):
                yield number, start, outcome

        if recalled is None and executor is not None:
            tasks = _Tasks(solver, batches, remaining, executor, memory, begins, outcomes)
            yield from _on_workers(tasks)
            return


def require_executor(executor: Any) -> None:
    """Raise TypeError if this is not an executor."""
    if executor is not None and not isinstance(executor, Executor):
        raise TypeError(
            f"executor is {executor!r:.60}: give an instance such as greybox.solve.WorkerPool(2)."
        )


def packed(solver: Runner) -> tuple[str, bytes]:
    """Return a name of a solver, the same in every process, and the pickled solver."""
    payload = pickle.dumps(solver)
    return hashlib.sha256(payload).hexdigest(), payload


def _batches(numbered: Iterable[tuple[int, Array]], size: int) -> Iterator[Batch]:
    iterator = iter(numbered)
    while batch := list(islice(iterator, size)):
        yield batch


def _recalled(memory: Memory, batch: Batch) -> list[Outcome] | None:
    """Return the stored outcomes of a batch if all of them are stored.

    Otherwise the whole batch is run: the last digits of a run depend on how many are run together.
    """
    outcomes = [memory.recall(number, start) for number, start in batch]
    complete = [outcome for outcome in outcomes if outcome is not None]
    return complete if len(complete) == len(batch) else None


def _run(solver: Runner, starts: Array) -> list[Outcome]:
    """Run a batch within the time limit of all of its starts."""
    with one_run(starts=len(starts)):
        return solver.run_together(starts)


def _on_workers(tasks: "_Tasks") -> Iterator[tuple[int, Array, Outcome]]:
    try:
        while not stop_requested():
            tasks.hand_out()
            if not tasks.waiting:
                return
            if tasks.is_next_done():
                yield from tasks.next()

        # After Ctrl-C the tasks that have begun are finished.
        tasks.cancel()
        while tasks.waiting and not tasks.waiting[0].future.cancelled():
            yield from tasks.next()
    finally:
        tasks.cancel()


@dataclass
class _Task:
    """A batch of starts, the future of their outcomes, and whether the memory has them."""

    batch: Batch
    future: Future[list[Outcome]]
    is_stored: bool = False


class _Tasks:
    """The tasks of one search, in the order of the starts; `first` are the runs made here."""

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
        self._packed, self._together = packed(solver), solver.together
        self._batches, self._begins = batches, begins
        self._executor, self._memory = executor, memory
        self._next_batch: Batch | None = None
        self._most = min(max(MOST_BYTES // len(self._packed[1]), 2), MOST_WAITING)
        # Sixteen tasks or more, so that workers of unlike speed end at about the same time.
        self._largest = max(math.ceil(count / 16), 1)
        self._runs = len(first)
        self._seconds = sum(outcome.seconds for outcome in first)

    def hand_out(self) -> None:
        """Hand out tasks until enough are waiting, or all are handed out."""
        while len(self.waiting) < self._most and not stop_requested():
            size = max(int(TASK_SECONDS * self._runs / max(self._seconds, 1e-6)), 1)
            task = self._next_task(min(size, self._largest))
            if task is None:
                return
            self.waiting.append(task)

    def _next_task(self, most: int) -> _Task | None:
        """Make a task of the next batches, at most `most` starts, or of one stored batch."""
        starts: Batch = []
        while not starts or len(starts) + self._together <= most:
            batch = self._next_batch or next(self._batches, None)
            self._next_batch = None
            if batch is None:
                break
            recalled = _recalled(self._memory, batch)
            if recalled is None:
                starts += batch
            elif starts:
                self._next_batch = batch
                break
            else:
                task = _Task(batch, Future(), is_stored=True)
                task.future.set_result(recalled)
                return task
        return self._submitted(starts) if starts else None

    def _submitted(self, batch: Batch) -> _Task:
        begins = np.array([self._begins.get(number, start) for number, start in batch])
        return _Task(
            batch,
            self._executor.submit(run_starts, *self._packed, begins, os.getpid(), current_limits()),
        )

    def is_next_done(self) -> bool:
        """Wait for the first of the waiting tasks; False if a stop was requested before."""
        while not stop_requested():
            # A cancelled task is done, and its result says why.
            with suppress(CancelledError):
                try:
                    self.waiting[0].future.exception(timeout=0.1)
                except StillRunning:
                    self._store_finished()
                    continue
            return True
        return False

    def next(self) -> Iterator[tuple[int, Array, Outcome]]:
        """Yield the runs of the first waiting task.

        If its worker was lost, each of its starts becomes a task, so that only the start that ends
        workers is given up.
        """
        task = self.waiting.popleft()
        outcomes = self._stored(task)

        # One start of the batch may have ended the worker: each is tried alone.
        if outcomes is None and len(task.batch) > 1:
            self.waiting.extendleft([self._submitted([start]) for start in reversed(task.batch)])
            return
        if outcomes is None:
            [(number, start)] = task.batch
            outcomes = [Outcome(start, WORKER_LOST, 0, 0.0, converged=False, cost=math.inf)]
            self._memory.keep(number, start, outcomes[0])
        for (number, start), outcome in zip(task.batch, outcomes, strict=True):
            yield number, start, outcome

    def cancel(self) -> None:
        """Cancel the tasks that have not begun."""
        for task in self.waiting:
            task.future.cancel()

    def _store_finished(self) -> None:
        """Store the runs of all finished tasks, whichever task is waited for."""
        for task in self.waiting:
            future = task.future
            if future.done() and not future.cancelled() and future.exception() is None:
                self._stored(task)
        self._memory.look()
        if _has_lost_scheduler(self._executor):
            raise ExecutorLostError(LOST)

    def _stored(self, task: _Task) -> list[Outcome] | None:
        """Return the outcomes of a finished task, stored; None if its worker was lost."""
        outcomes = _result(task.future)
        if outcomes is not None and not task.is_stored:
            task.is_stored = True
            self._runs += len(outcomes)
            self._seconds += sum(outcome.seconds for outcome in outcomes)
            for (number, start), outcome in zip(task.batch, outcomes, strict=True):
                self._memory.keep(number, start, outcome)
        return outcomes


def _has_lost_scheduler(executor: Executor) -> bool:
    """Return whether Dask has lost its scheduler: new tasks would never be done."""
    if type(executor).__module__ != "distributed.cfexecutor":
        return False
    # By name, since the package that defines the class may be absent.
    return getattr(executor, "_client").status != "running"  # noqa: B009


def _result(future: Future[list[Outcome]]) -> list[Outcome] | None:
    """Return the outcomes of a task; None if its worker was lost and has been replaced."""
    try:
        return future.result()
    except WorkerLostError:
        return None
    except NoWorkerError as error:
        raise ExecutorLostError(str(error)) from error
    except CancelledError as error:
        raise ExecutorLostError(LOST) from error
    except Exception as error:
        message = " ".join(str(error).split())[:300].rstrip(".") or "no reason given"
        raise ExecutorLostError(
            f"a task of the executor failed, {type(error).__name__}: {message}. "
            "Start its workers again, or use greybox.solve.WorkerPool, which replaces lost workers."
        ) from error


# --- on the worker


class _Built(threading.local):
    """The solvers of this thread: a CasADi function must not be called by two at a time."""

    def __init__(self) -> None:
        self.solvers: OrderedDict[str, Runner] = OrderedDict()


_built = _Built()


def run_starts(
    key: str, payload: bytes, starts: Array, coordinator: int, limits: TimeLimits
) -> list[Outcome]:
    """Run the solver in `payload`, named by `key`, from every row of `starts` (r, p).

    `coordinator` is the process that decides about Ctrl-C, `limits` are the time limits of its
    search. A thread keeps the last four solvers, so that it serves the members of a study in turn
    without building them anew.
    """
    # A solver takes longer to build than many of its runs.
    solvers = _built.solvers
    with _without_interrupts(os.getpid() != coordinator), limited(limits):
        if key not in solvers:
            while len(solvers) >= 4:
                solvers.popitem(last=False)
            solvers[key] = one_thread_at_a_time(pickle.loads)(payload)
        solvers.move_to_end(key)
        solver = solvers[key]
        size = solver.together
        batches = (starts[k : k + size] for k in range(0, len(starts), size))
        return [outcome for batch in batches for outcome in _run(solver, batch)]


@contextmanager
def _without_interrupts(applies: bool) -> Iterator[None]:
    """Ignore Ctrl-C within, which a terminal sends to the workers as well."""
    if not applies or threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
