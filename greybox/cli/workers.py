"""The options that say what makes the runs of a fit: this process, others on this machine, or Dask's workers."""

import argparse
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from greybox.cli.options import UsageError, positive
from greybox.solve.worker_pool import WorkerPool

CONNECTING = 10  # s, after which a scheduler that does not answer is not there


def add_worker_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--workers", type=positive, metavar="N", help="make the runs in N processes on this machine"
    )
    group.add_argument(
        "--scheduler", metavar="ADDRESS", help="make the runs on Dask's workers: 127.0.0.1:8786"
    )


@contextmanager
def stated_executor(options: argparse.Namespace) -> Iterator[Executor | None]:
    """Give the executor that the options state, None for this process, and end it.

    Raises
    ------
    UsageError
        When Dask is not installed, or no scheduler answers.
    """
    if options.workers is not None and options.workers > 1:
        with WorkerPool(options.workers) as pool:
            yield pool
    elif options.scheduler is not None:
        with _client(options.scheduler) as client:
            yield client.get_executor()
    else:
        yield None


def _client(address: str):
    try:
        from distributed import Client  # noqa: PLC0415  (optional, and takes half a second to import)
    except ModuleNotFoundError:
        raise UsageError("--scheduler needs Dask: pip install 'greybox-id[dask]'.") from None
    try:
        return Client(address, timeout=CONNECTING)
    except (OSError, ValueError) as error:
        said = " ".join(str(error).split())[:200].rstrip(".")
        raise UsageError(
            f"no Dask scheduler answers at {address!r} ({said}): start one with `dask scheduler`."
        ) from None
