"""Combines simultaneous queries of several callers into batches. No Ray, no policy: only `asyncio`."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Generic, TypeVar

Question = TypeVar("Question")
Answer = TypeVar("Answer")


@dataclass(eq=False)
class _Request(Generic[Question, Answer]):
    questions: Sequence[Question]
    answers: asyncio.Future[Sequence[Answer]]


class Batcher(Generic[Question, Answer]):
    """Answers questions in batches.

    The questions of one call stay together and in order; more than `max_batch` of them make a batch of their own.
    """

    def __init__(
        self,
        answer: Callable[[Sequence[Question]], Sequence[Answer]],
        executor: Executor,
        *,
        max_batch: int,
        wait_s: float,
    ) -> None:
        """Create a batcher that calls `answer` in `executor`, with one batch at a time.

        A batch of several calls has at most `max_batch` questions, the first of which waits for others up to `wait_s`.
        """
        self._answer, self._executor, self._max_batch, self._wait_s = answer, executor, max_batch, wait_s
        self._waiting: deque[_Request[Question, Answer]] = deque()
        self._arrived = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        self.batches: Counter[int] = Counter()
        """Batch size to number of batches."""

    async def ask(self, questions: Sequence[Question]) -> Sequence[Answer]:
        """Return the answers to the questions, in order.

        Raises:
            Exception: What `answer` raises for these questions. Other questions of the batch are still answered.
        """
        request = _Request[Question, Answer](questions, asyncio.get_running_loop().create_future())
        self._waiting.append(request)
        self._arrived.set()
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._work())
        return await request.answers

    async def _work(self) -> None:
        while self._waiting:
            await self._gather()
            batch = self._next_batch()
            if not await self._answered(batch) and len(batch) > 1:
                for request in batch:
                    await self._answered([request])

    async def _gather(self) -> None:
        """Wait until a batch is full or its first question has waited for `wait_s`."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self._wait_s):
                while sum(len(request.questions) for request in self._waiting) < self._max_batch:
                    self._arrived.clear()
                    await self._arrived.wait()

    def _next_batch(self) -> list[_Request[Question, Answer]]:
        batch = [self._waiting.popleft()]
        size = len(batch[0].questions)
        while self._waiting and size + len(self._waiting[0].questions) <= self._max_batch:
            batch.append(self._waiting.popleft())
            size += len(batch[-1].questions)
        return batch

    async def _answered(self, batch: Sequence[_Request[Question, Answer]]) -> bool:
        """Answer a batch; False on failure. Only a single request gets the error, since any of several may cause it."""
        questions = [question for request in batch for question in request.questions]
        self.batches[len(questions)] += 1
        try:
            loop = asyncio.get_running_loop()
            answers = list(await loop.run_in_executor(self._executor, self._answer, questions))
            if len(answers) != len(questions):
                raise ValueError(f"expected {len(questions)} answers, got {len(answers)}")
        except Exception as error:
            if len(batch) == 1 and not batch[0].answers.done():
                batch[0].answers.set_exception(error)
            return False
        for request in batch:
            count = len(request.questions)
            if not request.answers.done():
                request.answers.set_result(answers[:count])
            answers = answers[count:]
        return True
