"""Gathers what several callers ask at the same time into one batch. No Ray, no policy: `asyncio` alone."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Generic, TypeVar

Question = TypeVar("Question")
Answer = TypeVar("Answer")


@dataclass(eq=False)
class _Asked(Generic[Question, Answer]):
    questions: Sequence[Question]
    answers: asyncio.Future[Sequence[Answer]]


class Batcher(Generic[Question, Answer]):
    """Answers in batches of at most `most` questions; the first of a batch waits for others `wait_s` at most.

    What one caller asks at once stays together and in order, and makes a batch of its own where it is more than `most`.
    """

    def __init__(
        self,
        answer: Callable[[Sequence[Question]], Sequence[Answer]],
        executor: Executor,
        *,
        most: int,
        wait_s: float,
    ) -> None:
        """Args: answer: called in `executor` with one batch at a time; most, wait_s: see above."""
        self._answer, self._executor, self._most, self._wait_s = answer, executor, most, wait_s
        self._waiting: deque[_Asked[Question, Answer]] = deque()
        self._came = asyncio.Event()
        self._at_work: asyncio.Task[None] | None = None
        self.batches: Counter[int] = Counter()
        """Size of a batch to how many there were."""

    async def ask(self, questions: Sequence[Question]) -> Sequence[Answer]:
        """Answers to the questions, in order.

        Raises:
            Exception: What `answer` raises for these questions. Others of the batch are answered all the same.
        """
        asked = _Asked[Question, Answer](questions, asyncio.get_running_loop().create_future())
        self._waiting.append(asked)
        self._came.set()
        if self._at_work is None or self._at_work.done():
            self._at_work = asyncio.create_task(self._work())
        return await asked.answers

    async def _work(self) -> None:
        while self._waiting:
            await self._gather()
            batch = self._take()
            if not await self._answered(batch) and len(batch) > 1:
                for asked in batch:
                    await self._answered([asked])

    async def _gather(self) -> None:
        deadline = asyncio.get_running_loop().time() + self._wait_s
        while sum(len(asked.questions) for asked in self._waiting) < self._most:
            self._came.clear()
            left = deadline - asyncio.get_running_loop().time()
            try:
                await asyncio.wait_for(self._came.wait(), max(0.0, left))
            except TimeoutError:
                return

    def _take(self) -> list[_Asked[Question, Answer]]:
        batch = [self._waiting.popleft()]
        size = len(batch[0].questions)
        while self._waiting and size + len(self._waiting[0].questions) <= self._most:
            batch.append(self._waiting.popleft())
            size += len(batch[-1].questions)
        return batch

    async def _answered(self, batch: Sequence[_Asked[Question, Answer]]) -> bool:
        """Answer a batch; False if it could not be. Of several callers none is told then: one of them is at fault."""
        questions = [question for asked in batch for question in asked.questions]
        self.batches[len(questions)] += 1
        try:
            loop = asyncio.get_running_loop()
            answers = list(await loop.run_in_executor(self._executor, self._answer, questions))
            if len(answers) != len(questions):
                raise ValueError(f"expected {len(questions)} answers, got {len(answers)}")
        except Exception as error:
            if len(batch) == 1:
                _tell(batch[0].answers, error)
            return False
        for asked in batch:
            own, answers = answers[: len(asked.questions)], answers[len(asked.questions) :]
            if not asked.answers.done():
                asked.answers.set_result(own)
        return True


def _tell(future: asyncio.Future[Sequence[Answer]], error: Exception) -> None:
    if not future.done():
        future.set_exception(error)
