"""The thread in which a policy computes."""

import threading

import pytest

from robogauntlet.orchestrator.inference.daemon_thread import DaemonThread


def test_calls_are_made_one_after_the_other_in_one_thread():
    thread = DaemonThread()
    names = [thread.submit(lambda number: (number, threading.get_ident()), number) for number in range(5)]
    results = [name.result(10) for name in names]
    assert [number for number, _ in results] == list(range(5))
    assert len({ident for _, ident in results}) == 1
    thread.shutdown()


def test_an_exception_is_raised_where_the_result_is_asked_for():
    thread = DaemonThread()
    with pytest.raises(ZeroDivisionError):
        thread.submit(lambda: 1 / 0).result(10)
    assert thread.submit(lambda: 2).result(10) == 2
    thread.shutdown()


def test_calls_that_were_not_begun_are_cancelled_on_demand():
    thread, begun, go_on = DaemonThread(), threading.Event(), threading.Event()
    first = thread.submit(lambda: (begun.set(), go_on.wait(30)))
    begun.wait(30)
    second = thread.submit(lambda: None)
    thread.shutdown(wait=False, cancel_futures=True)
    assert second.cancelled()
    go_on.set()
    assert first.result(30)
    with pytest.raises(RuntimeError, match="no call after shutdown"):
        thread.submit(lambda: None)
