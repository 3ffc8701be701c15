"""A pool of worker processes: what becomes of calls whose worker is killed.

`test_executors` has whole searches.
"""

import os
import signal
from pathlib import Path

import pytest

from greybox.engine.solve.lost_workers import WorkerLostError
from greybox.engine.solve.worker_pool import WorkerPool


@pytest.fixture(scope="module")
def pool():
    with WorkerPool(2) as pool:
        yield pool


def end_worker(file):
    """End the worker, the first time that the file is seen."""
    if not Path(file).exists():
        Path(file).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "second time"


def test_calls_return_their_results_and_errors(pool):
    assert [call.result() for call in [pool.submit(divmod, k, 3) for k in range(9)]] == [
        divmod(k, 3) for k in range(9)
    ]
    assert pool.submit(int, "11", base=2).result() == 3
    with pytest.raises(ValueError, match="invalid literal"):
        pool.submit(int, "x").result()


def test_a_call_whose_worker_is_killed_is_made_again(pool, tmp_path):
    pool.submit(abs, -1).result()
    assert pool.submit(end_worker, str(tmp_path / "seen")).result() == "second time"


def test_a_signal_to_all_processes_is_left_to_the_parent(pool):
    number = pool.submit(os.getpid).result()
    os.kill(number, signal.SIGTERM)
    # Either process may take a call: on a busy machine one took four in a row.
    assert any(pool.submit(os.getpid).result() == number for _ in range(200))


def test_a_call_that_always_ends_its_worker_is_lost_and_no_other(pool):
    pool.submit(abs, -1).result()
    calls = [pool.submit(abs, -k) for k in range(4)]
    deadly = pool.submit(os._exit, 1)
    calls += [pool.submit(abs, -k) for k in range(4)]
    assert isinstance(deadly.exception(), WorkerLostError)
    assert [call.result() for call in calls] == [0, 1, 2, 3] * 2


def test_a_worker_that_is_killed_between_two_calls_is_replaced():
    with WorkerPool(1) as pool:
        number = pool.submit(os.getpid).result()
        os.kill(number, signal.SIGKILL)
        assert pool.submit(os.getpid).result() != number


def test_calls_that_have_not_begun_are_cancelled(tmp_path):
    pool = WorkerPool(1)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    at_work = pool.submit(Path(pipe).read_text)  # until something is written
    waiting = pool.submit(abs, -1)
    assert waiting.cancel()
    pipe.write_text("go on")
    assert at_work.result() == "go on"
    pool.shutdown()
    with pytest.raises(RuntimeError, match="after shutdown"):
        pool.submit(abs, -1)


def test_its_size_is_that_of_the_machine_unless_stated(monkeypatch):
    assert repr(WorkerPool(2)) == "WorkerPool(2)"
    monkeypatch.setattr("greybox.engine.solve.worker_pool.os.cpu_count", lambda: 7)
    assert WorkerPool().num_workers == 7
