"""Batches of simultaneous queries, on a real event loop."""

import asyncio
import contextlib
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.orchestrator.inference.batcher import Batcher


@contextlib.contextmanager
def batcher(answer, max_batch=4, wait_s=0.05):
    with ThreadPoolExecutor(1) as thread:
        yield Batcher(answer, thread, max_batch=max_batch, wait_s=wait_s)


def doubled(questions):
    return [2 * question for question in questions]


async def ask_all(asker, callers):
    return await asyncio.gather(*(asker.ask(questions) for questions in callers), return_exceptions=True)


@given(st.lists(st.lists(st.integers(), min_size=1, max_size=6), max_size=12), st.integers(1, 8))
@settings(max_examples=40)
def test_every_caller_gets_its_own_answers_in_order(callers, max_batch):
    with batcher(doubled, max_batch, wait_s=0.001) as asker:
        assert asyncio.run(ask_all(asker, callers)) == [doubled(questions) for questions in callers]
    assert sum(size * count for size, count in asker.batches.items()) == sum(map(len, callers))
    assert all(size <= max(max_batch, *map(len, callers)) for size in asker.batches)


def test_a_full_batch_does_not_wait():
    with batcher(doubled, max_batch=3, wait_s=60.0) as asker:
        assert asyncio.run(ask_all(asker, [[1], [2], [3]])) == [[2], [4], [6]]
    assert asker.batches == {3: 1}


def test_a_question_waits_for_others_for_a_limited_time():
    with batcher(doubled, max_batch=100, wait_s=0.05) as asker:
        assert asyncio.run(ask_all(asker, [[1], [2]])) == [[2], [4]]
    assert asker.batches == {2: 1}


def test_questions_that_arrive_during_a_batch_share_the_next():
    going = threading.Event()

    def slow(questions):
        going.wait(10)
        return questions

    async def in_turn(asker):
        first = asyncio.create_task(asker.ask([0]))
        while not asker.batches:
            await asyncio.sleep(0.001)
        others = [asyncio.create_task(asker.ask([number])) for number in (1, 2, 3)]
        await asyncio.sleep(0.01)
        going.set()
        return await asyncio.gather(first, *others)

    with batcher(slow, max_batch=3, wait_s=0.0) as asker:
        assert asyncio.run(in_turn(asker)) == [[0], [1], [2], [3]]
    assert asker.batches == {1: 1, 3: 1}


def test_a_question_that_cannot_be_answered_fails_only_its_own_caller():
    def picky(questions):
        if 13 in questions:
            raise ValueError("13 is no number")
        return questions

    with batcher(picky) as asker:
        first, second, third = asyncio.run(ask_all(asker, [[1, 2], [13], [4]]))
    assert (first, third) == ([1, 2], [4])
    assert isinstance(second, ValueError)


def test_a_missing_answer_is_an_error():
    with batcher(lambda questions: questions[1:]) as asker:
        (found,) = asyncio.run(ask_all(asker, [[1, 2]]))
    assert isinstance(found, ValueError)
    assert str(found) == "expected 2 answers, got 1"


def test_a_cancelled_caller_does_not_affect_others():
    async def one_leaves(asker):
        leaving = asyncio.create_task(asker.ask([1]))
        staying = asyncio.create_task(asker.ask([2]))
        await asyncio.sleep(0)
        leaving.cancel()
        return await staying

    with batcher(doubled) as asker:
        assert asyncio.run(one_leaves(asker)) == [4]


@pytest.mark.parametrize("max_batch", [1, 4])
def test_one_batch_is_answered_at_a_time(max_batch):
    at_once = []

    def watched(questions):
        at_once.append(1)
        time.sleep(0.002)
        assert len(at_once) == 1
        at_once.clear()
        return questions

    with batcher(watched, max_batch, wait_s=0.0) as asker:
        assert asyncio.run(ask_all(asker, [[number] for number in range(9)])) == [[number] for number in range(9)]
