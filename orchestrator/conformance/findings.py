"""What checks find, and what a check is."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

from adapters.contract import AdapterError

if TYPE_CHECKING:
    from orchestrator.conformance.subject import Subject


class Outcome(StrEnum):
    """What became of a check."""

    PASSED = "passed"
    FAILED = "failed"
    SKIPPED = "skipped"
    """It does not apply to this task, or could not be played."""


@dataclass(frozen=True)
class Finding:
    """What one check found in one task. A failed check has one for each thing that is wrong."""

    check: str
    task: str
    outcome: Outcome
    expected: str = ""
    """What the contract promises."""
    seen: str = ""
    """What came instead; for a skipped check, why it was."""
    look: str = ""
    """Where to look for the mistake."""
    seconds: float = 0.0
    """That the check took."""

    def __str__(self) -> str:
        if self.outcome is Outcome.FAILED:
            return f"{self.check}: expected {self.expected}; seen: {self.seen}; look at {self.look}"
        return f"{self.check}: {self.outcome}" + (f": {self.seen}" if self.seen else "")


@dataclass(frozen=True)
class Fault:
    """Something that is not as promised."""

    expected: str
    seen: str


class NotApplicable(Exception):
    """There is nothing to be checked in this task; the message says why."""


class CannotOpen(Exception):
    """The task cannot be opened; one check says why, and the others are skipped."""


Body = Callable[["Subject"], Iterator[Fault]]


@dataclass(frozen=True)
class Check:
    """One promise of an adapter, and how it is checked."""

    name: str
    promise: str
    """In a sentence."""
    look: str
    """Where to look if it is broken."""
    body: Body
    """Yields what is wrong. May raise `NotApplicable`, and whatever the adapter raises."""
    renders: bool = False
    """Whether it needs images."""
    once: bool = False
    """Whether it tells more of the simulator than of the task, so that one task is enough."""

    def play(self, subject: Subject) -> list[Finding]:
        """What it finds in a task: at least one finding."""
        began = time.perf_counter()

        def found(outcome: Outcome, expected: str = "", seen: str = "", look: str = "") -> Finding:
            return Finding(self.name, subject.task, outcome, expected, seen, look, time.perf_counter() - began)

        try:
            if self.renders and not subject.simulator.renders:
                raise NotApplicable("this simulator draws nothing")
            faults = list(self.body(subject))
        except NotApplicable as reason:
            return [found(Outcome.SKIPPED, seen=str(reason))]
        except CannotOpen:
            return [found(Outcome.SKIPPED, seen="the task cannot be opened, see the check 'opens'")]
        except AdapterError as error:
            return [found(Outcome.FAILED, self.promise, f"{type(error).__name__}: {error}", self.look)]
        except Exception as error:
            text = str(error).splitlines() or ["no message"]
            return [found(Outcome.FAILED, self.promise, f"{type(error).__name__}: {text[0]}", place_of(error))]
        if not faults:
            return [found(Outcome.PASSED)]
        return [found(Outcome.FAILED, fault.expected, fault.seen, self.look) for fault in faults]


def check(name: str, *, look: str, renders: bool = False, once: bool = False) -> Callable[[Body], Check]:
    """Make a check of a function; the first line of its docstring is the promise."""

    def made(body: Body) -> Check:
        promise = (body.__doc__ or "").strip().splitlines()[0].rstrip(".")
        return Check(name, promise[0].lower() + promise[1:], look, body, renders, once)

    return made


def place_of(error: BaseException) -> str:
    """File and line where an exception was raised, outside of the checks themselves if it passed through an adapter."""
    frames = traceback.extract_tb(error.__traceback__)
    own = Path(__file__).parent
    outside = [frame for frame in frames if Path(frame.filename).parent != own]
    frame = (outside or list(frames))[-1]
    return f"{frame.filename}:{frame.lineno} in {frame.name}"
