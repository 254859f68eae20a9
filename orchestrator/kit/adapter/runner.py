"""Runs checks on the tasks of an adapter, each in a child process, so that a crash or a hang becomes a finding."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from itertools import chain
from typing import Any

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulator
from robogauntlet.orchestrator.kit.adapter.check import Check
from robogauntlet.orchestrator.kit.finding import Finding, Level
from robogauntlet.orchestrator.kit.process import CLOSE_S, CheckProcess
from robogauntlet.support.child_process import ChildEnded, ChildTimeout

TIME_LIMIT_S = 120.0
"""Time for one check, and for opening the task before the first (s)."""
CHILD = "adapter.child"
MAX_TASKS = 3
"""Tasks of a simulator that are checked by default."""
MAX_CRASHES = 3
"""Crashes or hangs of a task after which the other checks are skipped."""


def ask_new_process(task: str, request: Mapping[str, Any]) -> Any:
    """Return the answer of a new process; raises as `CheckProcess.ask`."""
    process = CheckProcess(task, CHILD, own_group=False)
    try:
        return process.ask(request, TIME_LIMIT_S)
    finally:
        process.close(CLOSE_S)


class TaskChecker:
    """Checks one task in a process that starts at first use, and again after a crash or a hang."""

    def __init__(self, task: str, limit_s: float = TIME_LIMIT_S) -> None:
        """Take `simulator/task` and a time limit for each check (s)."""
        self.task, self._limit_s = task, limit_s
        self._process: CheckProcess | None = None
        self._crashes = 0

    def run(self, check: Check) -> list[Finding]:
        """Run a check and return at least one finding, also if the adapter crashes or hangs."""
        if self._crashes >= MAX_CRASHES:
            reason = f"not run: the task's process has crashed or hung {self._crashes} times"
            return [Finding(check.name, Level.SKIPPED, reason, task=self.task)]
        if self._process is None:
            self._process = CheckProcess(self.task, CHILD)
        try:
            answer = self._process.ask({"check": check.name}, self._limit_s)
        except ChildEnded as error:
            return self._failed(check, "the process to survive", str(error), check.look)
        except ChildTimeout as error:
            return self._failed(check, f"an answer within {self._limit_s:g} s", "none", str(error))
        return list(map(Finding.from_plain, answer))

    def _failed(self, check: Check, expected: str, seen: str, look: str) -> list[Finding]:
        self.close()
        self._crashes += 1
        return [Finding(check.name, Level.FAILED, seen, task=self.task, expected=expected, look=look)]

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close(CLOSE_S)
            self._process = None


def default_tasks(simulator: Simulator) -> list[str]:
    """Return the tasks that are checked by default: all if they are few, else some, evenly spread."""
    names = [f"{simulator.name}/{task}" for task in simulator.tasks]
    if len(names) <= MAX_TASKS:
        return names
    return [names[round(i * (len(names) - 1) / (MAX_TASKS - 1))] for i in range(MAX_TASKS)]


def checks_for(tasks: Sequence[str], checks: Iterable[Check], *, every: bool) -> dict[str, list[Check]]:
    """Return the checks of each task: a check for which one task is enough runs on the first only, unless `every`."""
    planned, found = list(checks), {}
    for task in tasks:
        fitting = (None, bool(catalog.body_of(task).joints))
        own = [check for check in planned if check.of_joints in fitting]
        found[task] = [check for check in own if every or task == tasks[0] or not check.once]
    return found


def run_checks(
    planned: Mapping[str, Sequence[Check]],
    *,
    limit_s: float = TIME_LIMIT_S,
    on_finding: Callable[[Finding], None] = lambda finding: None,
) -> list[Finding]:
    """Run checks on tasks, as many tasks at the same time as there are cores, at most two.

    Args:
        planned: Checks of each `simulator/task`, all of which the catalog knows.
        limit_s: Time limit for each check (s).
        on_finding: Called with each finding as soon as it exists, from any thread.
    """

    def run_task(task: str) -> list[Finding]:
        findings = []
        with closing(TaskChecker(task, limit_s)) as checker:
            for finding in chain.from_iterable(map(checker.run, planned[task])):
                on_finding(finding)
                findings.append(finding)
        return findings

    with ThreadPoolExecutor(max_workers=min(2, len(os.sched_getaffinity(0)))) as pool:
        return list(chain.from_iterable(pool.map(run_task, planned)))
