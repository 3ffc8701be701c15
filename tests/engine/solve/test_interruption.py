"""Ctrl-C is a real signal here, raised where it hurts."""

import signal
import threading
import time

import pytest

from greybox.engine.solve import interruption
from greybox.engine.solve.interruption import (
    Response,
    listening,
    responding,
    stop_requested,
    take_interrupt,
)


def test_at_first_it_raises(press_ctrl_c):
    with pytest.raises(KeyboardInterrupt), listening():
        press_ctrl_c()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_search_sees_it_and_ends(press_ctrl_c):
    with listening():
        with responding(Response.STOP):
            assert not stop_requested()
            press_ctrl_c()
            assert stop_requested()
        assert not stop_requested()  # what follows the search is to be finished
        assert take_interrupt()
        assert not take_interrupt()


def test_what_has_begun_is_finished(press_ctrl_c):
    with listening(), responding(Response.FINISH):
        press_ctrl_c()
        assert not stop_requested()


def test_the_same_ctrl_c_may_arrive_twice(press_ctrl_c):
    with listening(), responding(Response.FINISH):
        press_ctrl_c()
        press_ctrl_c()


def test_pressed_again_it_does_not_wait(monkeypatch, press_ctrl_c):
    monkeypatch.setattr(interruption, "ECHO", -1.0)
    with listening(), responding(Response.FINISH):
        press_ctrl_c()
        with pytest.raises(KeyboardInterrupt):
            press_ctrl_c()


def test_an_error_after_it_was_caused_by_it(press_ctrl_c):
    def broken():
        press_ctrl_c()
        raise RuntimeError("Error in Function::call")

    with pytest.raises(KeyboardInterrupt), listening(), responding(Response.STOP):
        broken()
    with pytest.raises(RuntimeError), responding(Response.STOP):
        raise RuntimeError("Error in Function::call")


def test_a_program_that_handles_the_signal_itself_keeps_its_handler(press_ctrl_c):
    seen = []
    before = signal.signal(signal.SIGINT, lambda *_: seen.append("own"))
    try:
        with listening(), responding(Response.STOP):
            press_ctrl_c()
            assert not stop_requested()
    finally:
        signal.signal(signal.SIGINT, before)
    assert seen == ["own"]


def test_other_threads_are_left_alone(press_ctrl_c):
    seen = []

    def work():
        with listening(), responding(Response.STOP):
            seen.append(stop_requested())

    with listening(), responding(Response.STOP):
        press_ctrl_c()
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
        assert stop_requested()
    assert seen == [False]


@pytest.mark.usefixtures("press_ctrl_c")  # whose handler is then Python's
def test_an_error_without_it_stays_what_it_is():
    with pytest.raises(ZeroDivisionError), listening():
        raise ZeroDivisionError
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_arrives_half_a_second_later_is_pressed_again(monkeypatch, press_ctrl_c):
    times = iter([100.0, 100.49, 100.51])
    monkeypatch.setattr(interruption.time, "monotonic", lambda: next(times))
    with listening(), responding(Response.FINISH):
        press_ctrl_c()
        press_ctrl_c()
        with pytest.raises(KeyboardInterrupt):
            press_ctrl_c()


def test_a_model_that_takes_longer_to_build_than_the_time_limit_is_given_up(monkeypatch):
    monkeypatch.setattr(interruption, "BUILDING", 0.01)
    limits = interruption.end_after(0.02)
    with (
        pytest.raises(TimeoutError, match="while the model was being built"),
        interruption.limited(limits),
        interruption.building(),
    ):
        time.sleep(5)
    with interruption.limited(limits), interruption.building():
        pass
    time.sleep(0.03)  # no alarm is left
