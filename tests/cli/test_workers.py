"""The options that say what makes the runs of a fit."""

from argparse import Namespace

import pytest

from greybox.cli.options import UsageError
from greybox.cli.workers import stated_executor
from greybox.engine.solve.worker_pool import WorkerPool


@pytest.mark.parametrize("workers", [None, 1])
def test_one_process_is_this_one(workers):
    with stated_executor(Namespace(workers=workers, scheduler=None)) as executor:
        assert executor is None


def test_several_workers_are_a_pool():
    with stated_executor(Namespace(workers=2, scheduler=None)) as executor:
        assert isinstance(executor, WorkerPool)


def test_workers_and_a_scheduler_exclude_one_another():
    options = Namespace(workers=3, scheduler="127.0.0.1:8786")
    with pytest.raises(UsageError, match="exclude each other"), stated_executor(options):
        pass
