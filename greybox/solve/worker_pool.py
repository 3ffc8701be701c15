"""Worker processes on this machine that are replaced when they are lost."""

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from typing import Any

# How often a task is tried whose worker is lost, after the first time alone: it may have been
# another task's fault.
TRIALS = 3
# The same of a pool of which no worker ever began.
TRIALS_AT_FIRST = 2

# A process each; the libraries' own threads would compete with them.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class WorkerLostError(RuntimeError):
    """The worker of a task was killed, as often as the task was tried."""


class NoWorkerError(RuntimeError):
    """Not one worker could begin."""


class _Task(Future[Any]):
    """What was handed to the pool, and its result."""

    def __init__(self, pool: "WorkerPool", call: Callable[[Executor], Future[Any]]) -> None:
        super().__init__()
        self.call = call
        self.trials = 0
        self.inner: Future[Any] | None = None
        self._pool = pool

    def cancel(self) -> bool:
        """Take it back unless a worker has begun it."""
        return self._pool._take_back(self) and super().cancel()


class WorkerPool(Executor):
    """So many processes on this machine, as an executor for `fit`, one thread each; those that are killed are replaced.

    ``with gb.solve.WorkerPool(4) as workers: gb.fit(problem, executor=workers)``. In a script, what
    starts it stands under ``if __name__ == "__main__":``, since the workers import the script.

    Parameters
    ----------
    workers : int, optional
        As many as the machine has processors by default.

    Raises
    ------
    ValueError
        For less than one worker.
    """

    def __init__(self, workers: int | None = None) -> None:
        workers = workers if workers is not None else os.cpu_count() or 1
        if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
            raise ValueError(f"workers is {workers!r}: give a whole number of at least 1.")
        self.num_workers = workers
        self._lock = threading.RLock()
        self._closed = False
        self._worked = False
        self._waiting: deque[_Task] = deque()
        self._suspects: deque[_Task] = deque()  # whose worker was lost
        self._begun = 0
        # Kept, since a pool that ends while it tells of its loss waits for itself for ever (Python
        # 3.12).
        self._lost: list[Executor] = []
        self._pool = self._new_pool()

    def __repr__(self) -> str:
        return f"WorkerPool({self.num_workers})"

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Hand out a task."""
        with self._lock:
            if self._closed:
                raise RuntimeError(
                    "the WorkerPool was shut down: use it within its with statement."
                )
            task = _Task(self, lambda pool: pool.submit(fn, *args, **kwargs))
            self._waiting.append(task)
            self._hand_out()
        return task

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes, after the tasks that were handed out."""
        with self._lock:
            self._closed = True
            left = [*self._waiting, *self._suspects]
        for task in left:
            if cancel_futures:
                task.cancel()
            elif wait:
                task.exception()
        for pool in (*self._lost, self._pool):
            pool.shutdown(wait, cancel_futures=cancel_futures)

    def _new_pool(self) -> Executor:
        import multiprocessing  # noqa: PLC0415  (only those who use it wait for it)
        from concurrent.futures import ProcessPoolExecutor  # noqa: PLC0415  (as above)

        # Forked processes would share the locks of threads that they do not have.
        return ProcessPoolExecutor(
            self.num_workers, multiprocessing.get_context("spawn"), _as_worker
        )

    def _replace(self, pool: Executor) -> None:
        """Take another pool for this one, unless that was done."""
        if self._pool is pool:
            self._lost.append(pool)
            self._pool = self._new_pool()

    def _hand_out(self) -> None:
        """Give the workers what waits; suspects one at a time, so that it is seen which of them ends its worker."""
        with self._lock:
            if self._suspects:
                if self._begun == 0:
                    self._begin(self._suspects.popleft())
                return
            while (
                self._waiting and self._begun <= self.num_workers
            ):  # one is ready when a worker is done
                self._begin(self._waiting.popleft())

    def _begin(self, task: _Task) -> None:
        task.trials += 1
        self._begun += 1
        with _single_threads():
            try:
                task.inner = task.call(self._pool)
            except BrokenExecutor:  # lost while nothing was done
                self._replace(self._pool)
                task.inner = task.call(self._pool)
        pool = self._pool
        task.inner.add_done_callback(lambda inner: self._end(task, inner, pool))

    def _end(self, task: _Task, inner: Future[Any], pool: Executor) -> None:
        """Hand on a result; where the pool has lost a worker, another one takes its place."""
        error = None if inner.cancelled() else inner.exception()
        with self._lock:
            self._begun -= 1
            if isinstance(error, BrokenExecutor):
                self._replace(pool)
                if task.trials < (TRIALS if self._worked else TRIALS_AT_FIRST):
                    self._suspects.append(task)
                    self._hand_out()
                    return
                error = (
                    WorkerLostError("the worker was killed.") if self._worked else _never_began()
                )
            elif not inner.cancelled():
                self._worked = True
            self._hand_out()
        if inner.cancelled() or not task.set_running_or_notify_cancel():
            return
        if error is not None:
            task.set_exception(error)
        else:
            task.set_result(inner.result())

    def _take_back(self, task: _Task) -> bool:
        with self._lock:
            for some in (self._waiting, self._suspects):
                if task in some:
                    some.remove(task)
                    return True
            inner = task.inner
        return inner is not None and inner.cancel()


def _never_began() -> NoWorkerError:
    return NoWorkerError(
        "no worker process could begin: in a script, put what it runs under if __name__ == '__main__':, since the "
        "workers import the script."
    )


def _as_worker() -> None:
    """Leave Ctrl-C to the process that started this one, which a terminal sends to both, and end when that one ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Wait for the end of the process that started this one; killed, it cannot tell its workers."""
    import multiprocessing  # noqa: PLC0415  (as above)

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _single_threads() -> Iterator[None]:
    """Give processes that start within an environment in which the libraries use one thread, unless it says more."""
    added = [name for name in THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]
