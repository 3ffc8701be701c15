"""Runs from many starts: one after the other in this process, or on the workers of an executor.

What travels is the solver, pickled as compiled functions and numbers without the user's classes, and the starts; what
comes back are outcomes. They are taken in the order of the starts, whoever finishes first: the answer does not depend
on the executor, on the number of workers, or on their speed.

Dask's workers have ``MALLOC_TRIM_THRESHOLD_`` in their environment, which makes every run of IPOPT take twice as long:
memory is given back and asked for again. Start them with it and ``MALLOC_MMAP_THRESHOLD_`` at 2000000000, one thread
each: ``dask worker ADDRESS --nworkers 2 --nthreads 1``.
"""

import hashlib
import math
import os
import pickle
import signal
import threading
from collections import OrderedDict, deque
from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from concurrent.futures import TimeoutError as StillRunning
from contextlib import contextmanager
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from greybox.solve.interruption import stop_requested
from greybox.solve.local_solver import LocalSolver
from greybox.solve.outcome import WORKER_LOST, Outcome
from greybox.solve.worker_pool import NoWorkerError, WorkerLostError

Array = NDArray[np.float64]

# Work of one task, s: two hundred times what a distributed scheduler takes to hand out a task, and little enough for
# progress to be seen and for Ctrl-C to be obeyed.
TASK_SECONDS = 0.3
# Tasks that a search has at least, so that workers of unlike speed end at about the same time.
FEWEST_TASKS = 16

# Tasks that are handed out and not done yet, at most, and their solvers' bytes: a scheduler holds all of them.
MOST_WAITING = 128
MOST_BYTES = 1 << 28

SOLVERS_KEPT = 4  # by a worker, so that it serves the members of a study in turn without building anew
LOOK = 0.1  # s, after which a search that waits for workers looks whether Ctrl-C was pressed


def run_all(
    solver: LocalSolver, starts: Iterable[Array], count: int, executor: Executor | None = None
) -> Iterator[tuple[Array, Outcome]]:
    """Give the starts (p,) and what a run from each leaves, in their order, until a stop is requested.

    `count` is how many there are. With an executor the first run is made here: it tells how long they take.

    Raises
    ------
    RuntimeError
        When the executor has lost its workers.
    """
    starts = iter(starts)
    for start in starts:
        if stop_requested():
            return
        outcome = solver.run(start)
        yield start, outcome
        if executor is not None:
            yield from _on_workers(solver, starts, count - 1, executor, outcome.seconds)
            return


def _on_workers(
    solver: LocalSolver, starts: Iterator[Array], count: int, executor: Executor, seconds: float
) -> Iterator[tuple[Array, Outcome]]:
    """Give starts and outcomes in order; `seconds` is what a run takes, about."""
    tasks = _Tasks(solver, starts, count, executor, seconds)
    try:
        while not stop_requested():
            tasks.hand_out()
            if not tasks.waiting:
                return
            if _is_done(tasks.waiting[0].future):
                yield from tasks.next()
        # Ctrl-C: what has begun is finished.
        tasks.cancel()
        while tasks.waiting and not tasks.waiting[0].future.cancelled():
            yield from tasks.next()
    finally:
        tasks.cancel()


class _Task(NamedTuple):
    starts: list[Array]
    future: Future[list[Outcome]]


class _Tasks:
    """The tasks of one search that are handed out, in the order of the starts."""

    def __init__(
        self, solver: LocalSolver, starts: Iterator[Array], count: int, executor: Executor, seconds: float
    ) -> None:
        self.waiting: deque[_Task] = deque()
        self._starts = starts
        self._executor = executor
        self._payload = pickle.dumps(solver)
        self._key = hashlib.sha256(self._payload).hexdigest()
        self._most = min(max(MOST_BYTES // len(self._payload), 2), MOST_WAITING)
        self._largest = max(math.ceil(count / FEWEST_TASKS), 1)
        self._done, self._seconds = 1, seconds

    def hand_out(self) -> None:
        """Hand out tasks until enough are waiting, or none is left."""
        while len(self.waiting) < self._most and not stop_requested():
            size = max(int(TASK_SECONDS * self._done / max(self._seconds, 1e-6)), 1)
            starts = list(islice(self._starts, min(size, self._largest)))
            if not starts:
                return
            self.waiting.append(self._task(starts))

    def next(self) -> Iterator[tuple[Array, Outcome]]:
        """Give what the first of the waiting tasks left; where its worker was lost, its starts are tried one by one."""
        starts, future = self.waiting.popleft()
        outcomes = _results(future)
        if outcomes is None and len(starts) > 1:
            self.waiting.extendleft([self._task([start]) for start in reversed(starts)])
            return
        outcomes = outcomes or [Outcome(starts[0], WORKER_LOST, 0, 0.0, converged=False, cost=math.inf)]
        self._done += len(outcomes)
        self._seconds += sum(outcome.seconds for outcome in outcomes)
        yield from zip(starts, outcomes, strict=True)

    def cancel(self) -> None:
        """Take back what has not begun."""
        for task in self.waiting:
            task.future.cancel()

    def _task(self, starts: list[Array]) -> _Task:
        arguments = (self._key, self._payload, np.array(starts), os.getpid())
        return _Task(starts, self._executor.submit(run_starts, *arguments))


def _is_done(future: Future[list[Outcome]]) -> bool:
    """Wait for a task; False when a stop was requested before."""
    while not stop_requested():
        try:
            future.exception(timeout=LOOK)
        except StillRunning:
            continue
        except CancelledError:
            pass
        return True
    return False


def _results(future: Future[list[Outcome]]) -> list[Outcome] | None:
    """Return the outcomes of a task; None when its worker was lost and can be replaced."""
    try:
        return future.result()
    except WorkerLostError:
        return None
    except NoWorkerError:
        raise
    except CancelledError as error:
        raise RuntimeError("the executor gave up its tasks: its workers or its scheduler are gone.") from error
    except Exception as error:
        said = " ".join(str(error).split())[:300].rstrip(".") or "no reason given"
        raise RuntimeError(
            f"a task of the executor failed, {type(error).__name__}: {said}. Start its workers again, or use "
            "greybox.solve.WorkerPool, which replaces those that it loses."
        ) from error


# --- on the worker ----------------------------------------------------------------------------------------------------


class _Built(threading.local):
    """The solvers of this thread: CasADi's functions serve one at a time."""

    def __init__(self) -> None:
        self.solvers: OrderedDict[str, LocalSolver] = OrderedDict()


_built = _Built()


def run_starts(key: str, payload: bytes, starts: Array, coordinator: int) -> list[Outcome]:
    """Run the solver in `payload`, which `key` names, from every row of `starts` (r, p).

    `coordinator` is the number of the process that decides about Ctrl-C.
    """
    solvers = _built.solvers
    with _deaf_to_interrupts(os.getpid() != coordinator):
        if key not in solvers:
            while len(solvers) >= SOLVERS_KEPT:
                solvers.popitem(last=False)
            solvers[key] = pickle.loads(payload)
        solvers.move_to_end(key)
        return [solvers[key].run(start) for start in starts]


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
