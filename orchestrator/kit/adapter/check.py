"""A check of an adapter, and its results."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from robogauntlet.adapters.contract import AdapterError
from robogauntlet.orchestrator.kit.adapter.checked_task import (
    CannotOpen,
    CheckedTask,
    EpisodeOver,
    Start,
    describe,
)


class Outcome(StrEnum):
    """How a check ended."""

    PASSED = "passed"
    FAILED = "failed"
    SKIPPED = "skipped"
    """It does not apply to this task, or could not run."""


@dataclass(frozen=True)
class CheckResult:
    """The result of one check in one task. A failed check has a result for each violation."""

    check: str
    task: str
    outcome: Outcome
    expected: str = ""
    """The promise of the contract."""
    seen: str = ""
    """What was seen instead; the reason of a skipped check."""
    look: str = ""
    """Where to look for the mistake."""
    seconds: float = 0.0
    """Duration of the check."""

    def __str__(self) -> str:
        if self.outcome is Outcome.FAILED:
            return f"{self.check}: expected {self.expected}; seen: {self.seen}; look at {self.look}"
        return f"{self.check}: {self.outcome}" + (f": {self.seen}" if self.seen else "")


@dataclass(frozen=True)
class Violation:
    """A broken promise."""

    expected: str
    seen: str


class NotApplicable(Exception):
    """The check does not apply to this task; the message says why."""


Body = Callable[[CheckedTask], Iterator[Violation]]


@dataclass(frozen=True)
class Check:
    """One promise of an adapter, and the function that checks it."""

    name: str
    promise: str
    """In a sentence."""
    look: str
    """Where to look for the mistake if the promise is broken."""
    body: Body
    """Yields violations. May raise `NotApplicable`, and whatever the adapter raises."""
    renders: bool = False
    """Whether it needs images."""
    once: bool = False
    """Whether one task of a simulator is enough."""
    of_joints: bool | None = None
    """Whether it is for tasks with the targets of joints (True), for those that move a tool (False), or for both."""

    def run(self, subject: CheckedTask) -> list[CheckResult]:
        """Run the check in a task and return at least one result."""
        start = time.perf_counter()

        def result(outcome: Outcome, expected: str = "", seen: str = "", look: str = "") -> CheckResult:
            return CheckResult(self.name, subject.task, outcome, expected, seen, look, time.perf_counter() - start)

        try:
            if self.renders and not subject.simulator.renders:
                raise NotApplicable("this simulator does not render")
            if self.of_joints not in (None, bool(subject.description.joints)):
                raise NotApplicable("an action moves the tool" if self.of_joints else "an action has targets of joints")
            violations = list(self.body(subject))
        except NotApplicable as reason:
            return [result(Outcome.SKIPPED, seen=str(reason))]
        except CannotOpen:
            return [result(Outcome.SKIPPED, seen="the task cannot be opened, see the check 'opens'")]
        except EpisodeOver:
            return [result(Outcome.SKIPPED, seen="the simulation ends the episode before the check is through")]
        except AdapterError as error:
            return [result(Outcome.FAILED, self.promise, f"{type(error).__name__}: {error}", self.look)]
        except Exception as error:
            return [result(Outcome.FAILED, self.promise, describe(error), place_of(error))]
        if not violations:
            return [result(Outcome.PASSED)]
        return [result(Outcome.FAILED, violation.expected, violation.seen, self.look) for violation in violations]


def check(
    name: str, *, look: str, renders: bool = False, once: bool = False, of_joints: bool | None = None
) -> Callable[[Body], Check]:
    """Turn a function into a check; the first line of its docstring is the promise."""

    def decorate(body: Body) -> Check:
        promise = (body.__doc__ or "").strip().splitlines()[0].rstrip(".")
        return Check(name, promise[0].lower() + promise[1:], look, body, renders, once, of_joints)

    return decorate


def expect(holds: object, expected: str, seen: object) -> Iterator[Violation]:
    """Yield a violation unless `holds` is true."""
    if not holds:
        yield Violation(expected, str(seen))


def expect_restored(subject: CheckedTask, start: Start, expected: str, *, picture: bool = True) -> Iterator[Violation]:
    """Reset, and yield a violation for each difference from the start of that seed's episode."""
    subject.reset(start.seed)
    for difference in subject.differences(start, picture=picture):
        yield Violation(expected, difference)


def place_of(error: BaseException) -> str:
    """File and line where an exception was raised, in the adapter if it passed through one."""
    frames = traceback.extract_tb(error.__traceback__)
    outside = [frame for frame in frames if Path(frame.filename).parent != Path(__file__).parent]
    frame = (outside or list(frames))[-1]
    return f"{frame.filename}:{frame.lineno} in {frame.name}"
