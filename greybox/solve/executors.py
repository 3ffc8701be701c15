"""Runs from many starts: one after the other in this process, or on the workers of an executor.

Begin with `run_all`. A worker receives the solver, pickled as compiled functions and numbers
without the user's classes, and starts; it returns outcomes. They are taken in the order of the
starts, whichever finishes first: the answer does not depend on the executor, on the number of
workers, or on their speed.

Dask's workers have ``MALLOC_TRIM_THRESHOLD_`` in their environment, which makes every run of IPOPT
take twice as long: memory is released and requested again and again. Start them with it and
``MALLOC_MMAP_THRESHOLD_`` at 2000000000, one thread each: ``dask worker ADDRESS --nworkers 2
--nthreads 1``.
"""

import hashlib
import io
import math
import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future
from concurrent.futures import TimeoutError as StillRunning
from contextlib import contextmanager, suppress
from itertools import islice
from types import MappingProxyType
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from greybox.files.arrays import Array
from greybox.modeling.one_thread import PerThread
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
    executor: Executor | None,
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
        If the stored runs began from other starts.
    """
    memory = memory or Memory()
    batches = _batches(numbered, solver.together)
    remaining = count
    for batch in batches:
        if interrupt_noted() or (remaining < count and stop_requested()):
            return
        remaining -= len(batch)

        recalled = _recalled(memory, batch)
        outcomes = recalled or _run(solver, _begins(batch, begins))
        finished = [outcome.status not in (INTERRUPTED, SEARCH_OVER) for outcome in outcomes]
        for (number, start), outcome, is_finished in zip(batch, outcomes, finished, strict=True):
            memory.keep(number, start, outcome)
            if is_finished or not any(finished):
                yield number, start, outcome

        if recalled is None and executor is not None:
            # Measured on the first batch: only so much work in a task shows progress in time.
            # Sixteen tasks or more, so that workers of unlike speed end at about the same time.
            seconds = sum(outcome.seconds for outcome in outcomes)
            size = int(TASK_SECONDS * len(batch) / max(seconds, 1e-6))
            size = max(min(size, math.ceil(remaining / 16)), 1)
            tasks = _Tasks(solver, executor, memory, begins)
            yield from _on_workers(tasks, _tasks(batches, memory, size))
            return


def require_executor(executor: Any) -> None:
    """Raise TypeError if this is not an executor."""
    if executor is not None and not isinstance(executor, Executor):
        raise TypeError(
            f"executor is {executor!r:.60}: give an instance such as greybox.solve.WorkerPool(2)."
        )


# Problems of the same formulas share functions, and to serialize them takes a millisecond.
_serialized: WeakKeyDictionary[ca.Function, str] = WeakKeyDictionary()


class _FingerprintPickler(pickle.Pickler):
    """Serializes each function once."""

    def reducer_override(self, value: Any) -> Any:
        if not isinstance(value, ca.Function):
            return NotImplemented
        if value not in _serialized:
            _serialized[value] = value.serialize()
        return str, (_serialized[value],)


def value_fingerprint(value: Any) -> str:
    """Return a key of a value, such as a runner, that is the same in every process."""
    text = io.BytesIO()
    pickler = _FingerprintPickler(text)
    # References to earlier objects would distinguish equal strings from identical ones.
    pickler.fast = True
    pickler.dump(value)
    return hashlib.sha256(text.getvalue()).hexdigest()


def pickled(value: Any) -> bytes:
    """Return a value for a worker; empty if it cannot travel."""
    with suppress(Exception):
        return pickle.dumps(value)
    return b""


unpickled = pickle.loads


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


def _begins(batch: Batch, begins: Mapping[int, Array]) -> Array:
    """Return where the runs of a batch begin, (r, s)."""
    return np.array([begins.get(number, start) for number, start in batch])


def _tasks(
    batches: Iterator[Batch], memory: Memory, most: int
) -> Iterator[tuple[Batch, list[Outcome] | None]]:
    """Yield batches, joined up to this many starts, and stored ones with their outcomes."""
    starts: Batch = []
    for batch in batches:
        recalled = _recalled(memory, batch)
        # A batch stays whole: the last digits of a run depend on how many are run together.
        if starts and (recalled is not None or len(starts) + len(batch) > most):
            yield starts, None
            starts = []
        if recalled is None:
            starts = starts + batch
        else:
            yield batch, recalled
    if starts:
        yield starts, None


def _on_workers(
    tasks: "_Tasks", remaining: Iterator[tuple[Batch, list[Outcome] | None]]
) -> Iterator[tuple[int, Array, Outcome]]:
    """Yield the runs of all tasks in order; at most this many are handed out and not yet done."""
    waiting = tasks.waiting
    try:
        while not stop_requested():
            for batch, recalled in islice(remaining, max(tasks.most - len(waiting), 0)):
                waiting.append(tasks.submitted(batch, recalled))
            if not waiting:
                return
            if tasks.is_next_done():
                yield from tasks.next()

        # After Ctrl-C the tasks that have begun are finished.
        tasks.cancel()
        while waiting and not waiting[0].future.cancelled():
            yield from tasks.next()
    finally:
        tasks.cancel()


class _Task(NamedTuple):
    """A batch of starts, and the future of their outcomes."""

    batch: Batch
    future: Future[list[Outcome]]


class _Tasks:
    """The tasks of one search that are handed out, in the order of the starts."""

    def __init__(
        self, solver: Runner, executor: Executor, memory: Memory, begins: Mapping[int, Array]
    ) -> None:
        self.waiting: deque[_Task] = deque()
        self._payload = pickle.dumps(solver)
        self._executor, self._memory, self._begins = executor, memory, begins
        self.most = min(max(MOST_BYTES // len(self._payload), 2), MOST_WAITING)

    def submitted(self, batch: Batch, recalled: list[Outcome] | None = None) -> _Task:
        """Return the task of a batch, done if its outcomes are `recalled`."""
        if recalled is not None:
            task = _Task(batch, Future())
            task.future.set_result(recalled)
            return task
        # Limits are of this thread, and the worker does not share it.
        begins, limits = _begins(batch, self._begins), current_limits()
        arguments = self._payload, begins, os.getpid(), limits
        return _Task(batch, self._executor.submit(run_starts, *arguments))

    def is_next_done(self) -> bool:
        """Wait for the first of the waiting tasks; False if a stop was requested before."""
        while not stop_requested():
            try:
                self.waiting[0].future.exception(timeout=0.1)
            except StillRunning:
                self._store_finished()
                continue
            except CancelledError:  # it is done, and its result says why
                pass
            return True
        return False

    def next(self) -> Iterator[tuple[int, Array, Outcome]]:
        """Yield the runs of the first waiting task.

        If its worker was lost, each of its starts becomes a task, so that only the start that ends
        workers is given up.
        """
        task = self.waiting.popleft()
        outcomes = self._stored(task)
        if outcomes is None and len(task.batch) > 1:
            self.waiting.extendleft([self.submitted([start]) for start in reversed(task.batch)])
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
        for (number, start), outcome in zip(task.batch, outcomes or (), strict=False):
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


# A solver takes longer to build than many of its runs. Four serve the members of a study in turn.
_solvers = PerThread(pickle.loads, 4)


def run_starts(
    payload: bytes, starts: Array, coordinator: int, limits: TimeLimits
) -> list[Outcome]:
    """Run the pickled solver `payload` from every row of `starts` (r, p).

    `coordinator` is the process that decides about Ctrl-C, `limits` are the time limits of its
    search.
    """
    with _without_interrupts(os.getpid() != coordinator), limited(limits):
        solver = _solvers.result(payload)
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
