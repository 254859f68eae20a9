"""Interruptions wait for the end of a block."""

import signal
import threading

import pytest

from robogauntlet.support.interrupts import SIGNALS, deferred_interrupts


@pytest.fixture
def received():
    """The signals that the process's own handlers have received."""
    numbers = []
    before = {number: signal.signal(number, lambda number, frame: numbers.append(number)) for number in SIGNALS}
    yield numbers
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_during_the_block_is_delivered_once_after_it(received, number):
    with deferred_interrupts():
        signal.raise_signal(number)
        signal.raise_signal(number)
        assert received == []
    assert received == [number]
    signal.raise_signal(number)
    assert received == [number, number]


def test_a_signal_is_delivered_although_the_block_fails(received):
    def fail():
        with deferred_interrupts():
            signal.raise_signal(signal.SIGINT)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert received == [signal.SIGINT]


def test_a_signal_waits_for_the_outer_of_two_blocks(received):
    with deferred_interrupts():
        with deferred_interrupts():
            signal.raise_signal(signal.SIGINT)
        assert received == []
    assert received == [signal.SIGINT]


def test_a_thread_runs_the_block_as_it_is():
    done = []

    def run():
        with deferred_interrupts():
            done.append(signal.getsignal(signal.SIGINT))

    before = signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert done == [before]
