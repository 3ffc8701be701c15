"""Runs from many starts: one after the other in this process, or on the workers of an executor.

Begin with `run_all`. A worker receives the solver, pickled as compiled functions and numbers
without the user's classes, and starts; it returns outcomes. They are taken in the order of the
starts, whichever finishes first: the answer does not depend on the executor, on the number of
workers, or on their speed. A run that raises an error on a worker is made again in this process, so
that it fails only where it would fail without workers.

Dask's workers have ``MALLOC_TRIM_THRESHOLD_`` in their environment, which makes every run of IPOPT
take twice as long: memory is released and requested again and again. Start them with it and
``MALLOC_MMAP_THRESHOLD_`` at 2000000000, one thread each: ``dask worker ADDRESS --nworkers 2
--nthreads 1``.
"""

import math
import os
import warnings
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from itertools import islice, starmap
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.solve.interruption import (
    interrupt_noted,
    search_end,
    stop_requested,
)
from greybox.engine.solve.local_solver import Runner
from greybox.engine.solve.lost_workers import ExecutorLostError, WorkerLostError
from greybox.engine.solve.run_storage import Memory
from greybox.engine.solve.runs import CUT_SHORT, WORKER_LOST, Outcome, Outcomes, has_raised
from greybox.engine.solve.worker_payload import pickled
from greybox.engine.solve.worker_task import run_starts
from greybox.modeling.fingerprint import value_fingerprint

Batch = list[tuple[int, Array]]
Made = Iterator[tuple[int, Array, Outcome]]
"""Number, start and outcome of runs."""

# Work of one task, s: two hundred times the overhead of a distributed scheduler, and short enough
# to show progress and to obey Ctrl-C.
TASK_SECONDS = 0.3
# Bytes of the solvers in all tasks that are handed out and not done yet, at most: a scheduler holds
# all of them.
MOST_BYTES = 1 << 28

LOST = "the executor gave up its tasks: its workers or its scheduler are gone."


def run_all(
    solver: Runner,
    numbered: Iterable[tuple[int, Array]],
    count: int,
    executor: Executor | None,
    memory: Memory | None = None,
) -> Made:
    """Yield (number, start, outcome) for every run, until a stop is requested.

    The runs come in the order of the `count` starts (s,) in `numbered`. As many are made at once as
    the solver runs together; if a stop cuts a batch short, its finished runs count. A run that
    raises an error fails alone, with the error as its status. With an executor the first batch is
    run here to measure how long a run takes. Runs in the `memory` are not made again.

    Raises
    ------
    ExecutorLostError
        If the executor has lost its workers.
    RunStorageError
        If the stored runs began from other starts.
    ValueError
        If an executor is given, and the solver calls Python, which workers cannot do.
    """
    if executor is not None:
        value_fingerprint(solver)  # refuses what cannot travel, before the first batch
    memory = memory or Memory()
    # If there are more starts than one batch, few come first: Ctrl-C soon has an answer. A batch of
    # a thousand takes a second.
    first = min(128 if count > solver.together else count, solver.together)
    batches = _batches(numbered, first, solver.together)
    remaining = count
    for batch in batches:
        if interrupt_noted() or (remaining < count and stop_requested()):
            return
        remaining -= len(batch)

        recalled = _recalled(memory, batch)
        outcomes = recalled or solver.outcomes(_starts(batch))
        finished = [outcome.status not in CUT_SHORT for outcome in outcomes]
        # A run that saw a stop in its last moment, or in a batch with others, may have ended
        # elsewhere than it would have alone: it counts now, but is made again.
        target = Memory() if stop_requested() else memory
        for run, is_finished in zip(_stored(target, batch, outcomes), finished, strict=True):
            if is_finished or not any(finished):
                yield run

        if recalled is None and executor is not None:
            # The first batch shows how long a start takes. A task has few enough of them that
            # progress appears in time, and there are sixteen tasks or more, so that workers of
            # different speed end at about the same time.
            seconds = sum(outcome.seconds for outcome in outcomes)
            size = int(TASK_SECONDS * len(batch) / max(seconds, 1e-6))
            size = min(size, math.ceil(remaining / 16))
            tasks = _tasks(batches, memory, size)
            yield from _on_workers(solver, executor, memory, tasks)
            return


def require_executor(executor: Any) -> None:
    """Raise TypeError if this is not an executor."""
    if not isinstance(executor, Executor | None):
        raise TypeError(
            f"executor is {executor!r:.60}: give an instance such as greybox.solve.WorkerPool(2)."
        )


def _batches(numbered: Iterable[tuple[int, Array]], first: int, size: int) -> Iterator[Batch]:
    iterator = iter(numbered)
    while batch := list(islice(iterator, first)):
        yield batch
        first = size


def _recalled(memory: Memory, batch: Batch) -> Outcomes | None:
    """Return the stored outcomes of a batch if all of them are stored.

    Otherwise the whole batch is run: the last digits of a run depend on how many are run together.
    """
    outcomes: list[Any] = list(starmap(memory.recall, batch))
    return None if None in outcomes else outcomes


def _starts(batch: Batch) -> Array:
    """Return the starts of a batch, (r, s)."""
    return np.array([start for _, start in batch])


def _tasks(
    batches: Iterator[Batch], memory: Memory, most: int
) -> Iterator[tuple[Batch, Outcomes | None]]:
    """Yield batches, joined up to this many starts, and stored ones with their outcomes."""
    starts: Batch = []
    for batch in batches:
        # A stop cuts short what finds the starts, too: these may not be those of the search.
        if stop_requested():
            return
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


def _stored(memory: Memory, batch: Batch, outcomes: Outcomes) -> Made:
    """Store the outcomes of a batch, and yield its runs."""
    for (number, start), outcome in zip(batch, outcomes, strict=True):
        memory.keep(number, start, outcome)
        yield number, start, outcome


def _on_workers(
    solver: Runner,
    executor: Executor,
    memory: Memory,
    tasks: Iterator[tuple[Batch, Outcomes | None]],
) -> Made:
    """Yield the runs of all tasks in order; some tasks at a time are handed out."""
    payload = pickled(solver)
    # The scheduler holds all tasks that are handed out.
    most = min(max(MOST_BYTES // len(payload), 2), 128)
    waiting: deque[tuple[Batch, Future[Outcomes]]] = deque()
    warned: set[str] = set()

    def submitted(batch: Batch, recalled: Outcomes | None = None) -> tuple[Batch, Future[Outcomes]]:
        if recalled is not None:
            future: Future[Outcomes] = Future()
            future.set_result(recalled)
            return batch, future
        # The time limit belongs to this thread, which the worker does not share.
        arguments = payload, _starts(batch), os.getpid(), search_end()
        return batch, executor.submit(run_starts, *arguments)

    try:
        while True:
            if stop_requested():  # the tasks that have begun are finished
                _cancel(waiting)
            else:
                free = max(most - len(waiting), 0)
                waiting.extend(starmap(submitted, islice(tasks, free)))
            if not waiting:
                return
            batch, future = waiting[0]
            if stop_requested() and future.cancelled():
                return
            if not future.done():
                wait([future], 0.1)  # s until the next look at Ctrl-C, tasks and scheduler
                _look(executor, memory, waiting)
                continue

            waiting.popleft()
            outcomes = _result(future)
            if outcomes is None and len(batch) > 1:
                # Each start becomes a task, and only the start that ends workers is given up.
                waiting.extendleft([submitted([start]) for start in reversed(batch)])
                continue
            if outcomes is None:
                outcomes = [solver.without_end(batch[0][1], WORKER_LOST)]
            yield from _stored(memory, batch, _made_here(solver, batch, outcomes, warned))
    finally:
        _cancel(waiting)


def _made_here(solver: Runner, batch: Batch, outcomes: Outcomes, warned: set[str]) -> Outcomes:
    """Return the outcomes of a task; batches in which a run raised an error are made again, here.

    A worker may lack what the run needs; an error of the model comes again. An error of the worker
    alone is a warning, unless its status is in `warned`, to which it is added.
    """
    size = solver.together
    for k in range(0, len(batch), size):
        there = outcomes[k : k + size]
        if any(has_raised(outcome.status) for outcome in there):
            outcomes[k : k + size] = solver.outcomes(_starts(batch[k : k + size]))
        for old, new in zip(there, outcomes[k : k + size], strict=True):
            if has_raised(old.status) and not has_raised(new.status) and old.status not in warned:
                warned.add(old.status)
                warnings.warn(
                    f"a worker could not make a run ({old.status}), and this process could: the "
                    "run was made here. The worker may lack a file or a package of this process.",
                    stacklevel=2,
                )
    return outcomes


def _cancel(waiting: Iterable[tuple[Batch, Future[Any]]]) -> None:
    """Cancel the tasks that have not begun."""
    for _, future in waiting:
        future.cancel()


def _look(
    executor: Executor, memory: Memory, waiting: Iterable[tuple[Batch, Future[Outcomes]]]
) -> None:
    """Store the runs of all finished tasks, whichever task is waited for."""
    for batch, future in waiting:
        if future.done() and not future.cancelled() and not future.exception():
            deque(_stored(memory, batch, future.result()), 0)
    memory.write_due()
    # Where Dask has lost its scheduler, new tasks would never be done. By name, since the package
    # that defines the class may be absent.
    is_of_dask = type(executor).__module__ == "distributed.cfexecutor"
    if is_of_dask and getattr(executor, "_client").status != "running":  # noqa: B009
        raise ExecutorLostError(LOST)


def _result(future: Future[Outcomes]) -> Outcomes | None:
    """Return the outcomes of a task; None if its worker was lost and has been replaced."""
    try:
        return future.result()
    except WorkerLostError:
        return None
    except ExecutorLostError:
        raise
    except CancelledError as error:
        raise ExecutorLostError(LOST) from error
    except Exception as error:
        # Dask has given the task to several workers, and lost all of them. By name, since the
        # package that defines the class may be absent.
        if type(error).__name__ == "KilledWorker":
            return None
        cure = "with the greybox, CasADi and NumPy of this process"
        if isinstance(error, BrokenExecutor):
            cure = "or use greybox.solve.WorkerPool, which replaces lost workers"
        message = " ".join(str(error).split())[:300].rstrip(".") or "no reason given"
        raise ExecutorLostError(
            f"a task of the executor failed, {type(error).__name__}: {message}. "
            f"Start its workers again, {cure}."
        ) from error
