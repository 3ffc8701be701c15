"""Worker processes on this machine, which are replaced when they are killed."""

import os
import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ThreadPoolExecutor,
)
from contextlib import suppress
from typing import Any

from greybox.data.files.argument_checks import require_whole
from greybox.data.files.public import public
from greybox.engine.solve.interruption import (
    ENDING,
)
from greybox.engine.solve.lost_workers import ExecutorLostError, WorkerLostError


@public
class WorkerPool(Executor):
    """Worker processes on this machine as an executor for `fit`; killed ones are replaced.

    ``with gb.solve.WorkerPool(4) as workers: gb.fit(problem, executor=workers)``. In a script, put
    these lines under ``if __name__ == "__main__":``, since the workers import the script.

    Parameters
    ----------
    workers : int, optional
        By default as many as the machine has processors.

    Raises
    ------
    ValueError
        For less than one worker.
    """

    def __init__(self, workers: int | None = None) -> None:
        workers = workers if workers is not None else os.cpu_count() or 1
        require_whole("workers", workers, 1)
        import multiprocessing  # noqa: PLC0415  (only those who use it wait for it)

        # A worker that imports an unguarded script gets here. It ends without a traceback, and
        # `ExecutorLostError` says what to change.
        if getattr(multiprocessing.current_process(), "_inheriting", False):
            raise SystemExit(1)
        self.num_workers = workers
        # A thread for each worker, which waits for it: a worker that is killed is then the loss of
        # one task alone.
        self._threads = ThreadPoolExecutor(workers)
        self._processes: dict[int, Executor] = {}  # by thread
        self._has_worked = False

    def __repr__(self) -> str:
        return f"WorkerPool({self.num_workers})"

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Queue a call for the next worker that is free.

        Raises
        ------
        RuntimeError
            After `shutdown`.
        """
        return self._threads.submit(self._call, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes, after the calls that were submitted."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for process in self._processes.values():
            process.shutdown(wait)

    def _call(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], options: dict[str, Any]
    ) -> Any:
        """Call a function in the process of this thread, or in the next one if that is killed."""
        thread = threading.get_ident()
        # Twice, since another program may have used up the memory when the worker ended.
        for _ in range(2):
            if thread not in self._processes:
                self._processes[thread] = _new_process()
            with suppress(BrokenExecutor):  # the process was killed between two calls
                call = self._processes[thread].submit(function, *arguments, **options)
                if not isinstance(call.exception(), BrokenExecutor):
                    self._has_worked = True
                    return call.result()
            del self._processes[thread]

        if self._has_worked:
            raise WorkerLostError("the worker was killed.")
        raise ExecutorLostError(
            "no worker process could begin: in a script, put what it runs under "
            "if __name__ == '__main__':, since the workers import the script."
        )


def _new_process() -> Executor:
    import multiprocessing  # noqa: PLC0415  (only those who use it wait for it)
    from concurrent.futures import ProcessPoolExecutor  # noqa: PLC0415  (as above)

    # Python's helper outlives a program that is killed, and would print a line about semaphores.
    sys.warnoptions.append("ignore:resource_tracker")
    # Forked processes would share the locks of threads that they do not have.
    return ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _prepare_worker)


def _prepare_worker() -> None:
    """Leave Ctrl-C and SIGTERM, which may go to all processes, to the parent, and end with it."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Wait for the end of the parent: one that is killed cannot tell its workers."""
    import multiprocessing  # noqa: PLC0415  (as above)

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
