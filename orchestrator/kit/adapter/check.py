"""A check of an adapter."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from robogauntlet.adapters.contract import AdapterError
from robogauntlet.orchestrator.kit.adapter.checked_task import CannotOpen, CheckedTask, EpisodeOver, Start, describe
from robogauntlet.orchestrator.kit.finding import Finding, Level


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
    of_robots: bool = False
    """Whether it needs the tool, joints or gripper of a robot, which native numbers do not show."""

    def run(self, subject: CheckedTask) -> list[Finding]:
        """Run the check in a task and return at least one finding, one for each violation."""
        start = time.perf_counter()

        def found(level: Level, text: str = "", expected: str = "", look: str = "") -> Finding:
            numbers = {"seconds": time.perf_counter() - start}
            return Finding(self.name, level, text, numbers, subject.task, expected, look)

        try:
            if self.renders and not subject.simulator.renders:
                raise NotApplicable("this simulator does not render")
            if (body := subject.description.body).native and (self.of_robots or self.of_joints is not None):
                raise NotApplicable(f"an action has {body.moves}")
            if self.of_joints not in (None, bool(subject.description.joints)):
                raise NotApplicable("an action moves the tool" if self.of_joints else "an action has targets of joints")
            violations = list(self.body(subject))
        except NotApplicable as reason:
            return [found(Level.SKIPPED, str(reason))]
        except CannotOpen:
            return [found(Level.SKIPPED, "the task cannot be opened, see the check 'opens'")]
        except EpisodeOver:
            return [found(Level.SKIPPED, "the simulation ends the episode before the check is through")]
        except AdapterError as error:
            return [found(Level.FAILED, f"{type(error).__name__}: {error}", self.promise, self.look)]
        except Exception as error:
            return [found(Level.FAILED, describe(error), self.promise, place_of(error))]
        failures = [found(Level.FAILED, broken.seen, broken.expected, self.look) for broken in violations]
        return failures or [found(Level.OK)]


def check(
    name: str,
    *,
    look: str,
    renders: bool = False,
    once: bool = False,
    of_joints: bool | None = None,
    of_robots: bool = False,
) -> Callable[[Body], Check]:
    """Turn a function into a check; the first line of its docstring is the promise."""

    def decorate(body: Body) -> Check:
        promise = (body.__doc__ or "").strip().splitlines()[0].rstrip(".")
        return Check(name, promise[0].lower() + promise[1:], look, body, renders, once, of_joints, of_robots)

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
