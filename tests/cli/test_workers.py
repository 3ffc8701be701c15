"""The options that say what makes the runs of a fit."""

from argparse import ArgumentParser, Namespace

import pytest

from greybox.cli.workers import add_worker_options, stated_executor
from greybox.solve.worker_pool import WorkerPool


@pytest.mark.parametrize("workers", [None, 1])
def test_one_process_is_this_one(workers):
    with stated_executor(Namespace(workers=workers, scheduler=None)) as executor:
        assert executor is None


def test_several_workers_are_a_pool():
    with stated_executor(Namespace(workers=2, scheduler=None)) as executor:
        assert isinstance(executor, WorkerPool)


def test_workers_and_a_scheduler_exclude_one_another(capsys):
    parser = ArgumentParser()
    add_worker_options(parser)
    assert parser.parse_args(["--workers", "3"]) == Namespace(workers=3, scheduler=None)
    with pytest.raises(SystemExit):
        parser.parse_args(["--workers", "3", "--scheduler", "127.0.0.1:8786"])
    assert "not allowed with argument --workers" in capsys.readouterr().err
