"""Where runs are made: in this process, in others on this machine, or by Dask's workers."""

import argparse
import logging
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from greybox.cli.options import UsageError
from greybox.data.files.optional_package import required
from greybox.engine.solve.worker_pool import WorkerPool

CONNECTING = 10  # s, until a scheduler that does not answer is given up


@contextmanager
def stated_executor(options: argparse.Namespace) -> Iterator[Executor | None]:
    """Yield the executor of the options, None for this process, and end it.

    Raises
    ------
    UsageError
        When both are stated, Dask is not installed, or no scheduler answers.
    """
    if options.workers and options.scheduler:
        raise UsageError("--workers and --scheduler exclude each other: give one of them.")
    # One worker would do the work of this process and cost the start of another one.
    if options.workers is not None and options.workers > 1:
        with WorkerPool(options.workers) as pool:
            yield pool
    elif options.scheduler:
        with _client(options.scheduler) as client:
            yield client.get_executor()
    else:
        yield None


def _client(address: str):
    dask = required("distributed", "dask", "--scheduler")
    # The client would print tracebacks of a scheduler that is lost, for which there is a sentence.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    # Without a limit a wrong address would wait forever.
    try:
        return dask.Client(address, timeout=CONNECTING)
    except (OSError, ValueError) as error:
        raise UsageError(
            f"no Dask scheduler answers at {address!r} ({error!s:.200}): start one with "
            "`dask scheduler`."
        ) from None
