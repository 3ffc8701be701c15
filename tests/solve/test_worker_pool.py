"""A pool of workers that are lost: which task is tried again, how often, and what is handed out meanwhile.

The processes are stood in for; `test_executors` has pools of real ones.
"""

from concurrent.futures import BrokenExecutor, Future

import pytest

from greybox.solve.worker_pool import (
    TRIALS,
    TRIALS_AT_FIRST,
    NoWorkerError,
    WorkerLostError,
    WorkerPool,
)


class Workers:
    """Holds what was handed to it until it is told how that ends."""

    def __init__(self):
        self.begun, self.ended, self.broken = [], None, False

    def submit(self, name):
        if self.broken:
            raise BrokenExecutor
        future = Future()
        self.begun.append((name, future))
        return future

    def shutdown(self, wait, *, cancel_futures):
        self.ended = (wait, cancel_futures)


@pytest.fixture
def pool(monkeypatch):
    made = []
    monkeypatch.setattr(WorkerPool, "_new_pool", lambda self: made.append(Workers()) or made[-1])
    pool = WorkerPool(2)
    pool.made = made
    # Tasks are handed to the stand-in by their name alone.
    return pool


def submit(pool, *names):
    return [pool.submit(name) for name in names]


def names(workers):
    return [name for name, _ in workers.begun]


def end(workers, name, result=None, *, lost=False):
    """End the last task of this name."""
    future = next(future for one, future in reversed(workers.begun) if one == name)
    if lost:
        future.set_exception(BrokenExecutor())
    else:
        future.set_result(result)


def test_each_worker_has_a_task_and_one_is_ready(pool):
    a, b, *_ = submit(pool, *"abcde")
    (workers,) = pool.made
    assert names(workers) == ["a", "b", "c"]
    end(workers, "b", 5)
    assert b.result(0) == 5
    assert names(workers) == ["a", "b", "c", "d"]
    assert not a.done()


def test_tasks_of_a_lost_worker_are_tried_alone_before_others_go_on(pool):
    a, b, c, d, e = submit(pool, *"abcde")
    (first,) = pool.made
    end(first, "a", 1)
    assert a.result(0) == 1
    for name in "bcd":
        end(first, name, lost=True)
    second = pool.made[1]
    assert len(pool.made) == 2
    assert names(second) == ["b"]
    end(second, "b", 2)
    assert names(second) == ["b", "c"]
    end(second, "c", lost=True)  # it ends its worker: the others were there by chance
    third = pool.made[2]
    assert names(third) == ["d"]
    end(third, "d", 4)
    assert names(third) == ["d", "c"]
    end(third, "c", lost=True)
    assert names(pool.made[3]) == ["e"]
    assert isinstance(c.exception(0), WorkerLostError)
    end(pool.made[3], "e", 5)
    assert [one.result(0) for one in (b, d, e)] == [2, 4, 5]
    assert c.trials == TRIALS == 3


def test_a_pool_of_which_no_worker_began_says_so_sooner(pool):
    (task,) = submit(pool, "a")
    end(pool.made[0], "a", lost=True)
    assert not task.done()
    end(pool.made[1], "a", lost=True)
    assert isinstance(task.exception(0), NoWorkerError)
    assert task.trials == TRIALS_AT_FIRST == 2


def test_workers_that_were_lost_while_nothing_was_done_are_replaced(pool):
    pool.made[0].broken = True
    (task,) = submit(pool, "a")
    assert names(pool.made[1]) == ["a"]
    end(pool.made[1], "a", 3)
    assert task.result(0) == 3


def test_an_error_of_a_task_is_its_own(pool):
    (task,) = submit(pool, "a")
    pool.made[0].begun[0][1].set_exception(ZeroDivisionError("own"))
    assert str(task.exception(0)) == "own"
    assert len(pool.made) == 1


def test_what_has_not_begun_is_taken_back(pool):
    tasks = submit(pool, *"abcde")
    (workers,) = pool.made
    assert tasks[4].cancel()
    assert tasks[2].cancel()  # handed out, and not begun
    workers.begun[0][1].set_running_or_notify_cancel()
    assert not tasks[0].cancel()
    assert names(workers) == ["a", "b", "c", "d"]
    end(workers, "a", 1)
    end(workers, "b", 2)
    end(workers, "d", 4)
    assert names(workers) == ["a", "b", "c", "d"]
    assert [task.cancelled() for task in tasks] == [False, False, True, False, True]
    assert tasks[3].result(0) == 4


@pytest.mark.parametrize("wait", [True, False])
def test_all_pools_end_with_it(pool, wait):
    tasks = submit(pool, *"abcde")
    end(pool.made[0], "a", lost=True)
    pool.shutdown(wait, cancel_futures=True)
    assert [one.ended for one in pool.made] == [(wait, True)] * 2
    assert tasks[4].cancelled()
    with pytest.raises(RuntimeError, match="was shut down"):
        pool.submit("f")


def test_its_size_is_that_of_the_machine_unless_stated(pool, monkeypatch):
    assert (pool.num_workers, repr(pool)) == (2, "WorkerPool(2)")
    monkeypatch.setattr("greybox.solve.worker_pool.os.cpu_count", lambda: 7)
    assert WorkerPool().num_workers == 7
    monkeypatch.setattr("greybox.solve.worker_pool.os.cpu_count", lambda: None)
    assert WorkerPool().num_workers == 1
