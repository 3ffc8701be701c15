"""Errors of workers that were lost."""


class WorkerLostError(RuntimeError):
    """The worker of a task was killed each time that the task was tried."""


class ExecutorLostError(RuntimeError):
    """An executor has lost its workers, or they cannot do its tasks."""
