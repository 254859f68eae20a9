"""Plays checks on the tasks of an adapter, each task in a process of its own."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from adapters import catalog
from adapters.contract import Simulator
from orchestrator.conformance.findings import Check, Finding, Outcome
from orchestrator.conformance.processes import TIME_LIMIT_S, Ended, Hung, Process
from orchestrator.conformance.subject import VIEW

MOST_TASKS = 3
"""How many tasks of a simulator are checked, unless all are asked for."""
MOST_ENDS = 3
"""Processes of a task that may crash or hang before the other checks are skipped."""


class Examination:
    """One task under check, in a process that is started when it is first needed, and again after it died or hung."""

    def __init__(self, task: str, limit_s: float = TIME_LIMIT_S) -> None:
        """Of `simulator/task`, with a time limit for each check."""
        self.task, self._limit_s = task, limit_s
        self._process: Process | None = None
        self._ends = 0

    def play(self, check: Check) -> list[Finding]:
        """What a check finds: at least one finding, also if the adapter crashes or hangs."""
        if self._ends >= MOST_ENDS:
            reason = f"not played: the task's process has crashed or hung {self._ends} times"
            return [Finding(check.name, self.task, Outcome.SKIPPED, seen=reason)]
        if self._process is None:
            cameras = catalog.task_cards()[self.task].cameras
            self._process = Process(self.task, replace(VIEW, cameras=cameras))
        try:
            told = self._process.ask({"check": check.name}, self._limit_s)
        except Ended as how:
            return self._failed(check, "the process to live", str(how), check.look)
        except Hung as where:
            return self._failed(check, f"an answer within {self._limit_s:g} s", "none", str(where))
        return [Finding(**{**finding, "outcome": Outcome(finding["outcome"])}) for finding in told]

    def _failed(self, check: Check, expected: str, seen: str, look: str) -> list[Finding]:
        self.close()
        self._ends += 1
        return [Finding(check.name, self.task, Outcome.FAILED, expected, seen, look)]

    def close(self) -> None:
        """End its process."""
        if self._process is not None:
            self._process.close()
            self._process = None


class Examinations:
    """The examination of one task at a time: checks of a task share a process, tasks do not."""

    def __init__(self) -> None:
        self._now: Examination | None = None

    def of(self, task: str) -> Examination:
        """The task's examination; that of another task is closed."""
        if self._now is None or self._now.task != task:
            self.close()
            self._now = Examination(task)
        return self._now

    def close(self) -> None:
        """Close the one that is open."""
        if self._now is not None:
            self._now.close()
            self._now = None


def default_tasks(simulator: Simulator) -> list[str]:
    """The tasks that are checked unless told otherwise: all if they are few, else some, evenly spread."""
    names = [f"{simulator.name}/{task}" for task in simulator.tasks]
    if len(names) <= MOST_TASKS:
        return names
    return [names[round(i * (len(names) - 1) / (MOST_TASKS - 1))] for i in range(MOST_TASKS)]


def checks_of(tasks: Sequence[str], checks: Iterable[Check], *, every: bool) -> dict[str, list[Check]]:
    """What is played on each task: those checks that tell more of the simulator on the first only, unless `every`."""
    wanted = list(checks)
    return {task: [check for check in wanted if every or task == tasks[0] or not check.once] for task in tasks}


def examine(
    wanted: Mapping[str, Sequence[Check]],
    *,
    limit_s: float = TIME_LIMIT_S,
    told: Callable[[Finding], None] = lambda finding: None,
) -> list[Finding]:
    """Play checks on tasks, as many tasks at once as there are cores, at most two.

    Args:
        wanted: What to play on each `simulator/task`, all of which the catalog knows.
        limit_s: For each check.
        told: Is given each finding as soon as it is there, from any thread.
    """

    def examined(task: str) -> list[Finding]:
        examination = Examination(task, limit_s)
        found = []
        try:
            for check in wanted[task]:
                for finding in examination.play(check):
                    told(finding)
                    found.append(finding)
        finally:
            examination.close()
        return found

    with ThreadPoolExecutor(max_workers=min(2, len(os.sched_getaffinity(0)))) as pool:
        return [finding for findings in pool.map(examined, wanted) for finding in findings]
