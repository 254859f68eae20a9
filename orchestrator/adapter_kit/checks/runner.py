"""Runs checks on the tasks of an adapter, each task in its own process."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulator
from robogauntlet.orchestrator.adapter_kit.checks.check import Check, CheckResult, Outcome
from robogauntlet.orchestrator.adapter_kit.checks.checked_task import VIEW
from robogauntlet.orchestrator.adapter_kit.checks.processes import TIME_LIMIT_S, Process
from robogauntlet.support.child_process import ChildEnded, ChildTimeout

MAX_TASKS = 3
"""Tasks of a simulator that are checked by default."""
MAX_CRASHES = 3
"""Crashes or hangs of a task after which the other checks are skipped."""


class TaskChecker:
    """Checks one task in a process that starts at first use, and again after a crash or a hang."""

    def __init__(self, task: str, limit_s: float = TIME_LIMIT_S) -> None:
        """Take `simulator/task` and a time limit for each check (s)."""
        self.task, self._limit_s = task, limit_s
        self._process: Process | None = None
        self._crashes = 0

    def run(self, check: Check) -> list[CheckResult]:
        """Run a check and return at least one result, also if the adapter crashes or hangs."""
        if self._crashes >= MAX_CRASHES:
            reason = f"not run: the task's process has crashed or hung {self._crashes} times"
            return [CheckResult(check.name, self.task, Outcome.SKIPPED, seen=reason)]
        if self._process is None:
            cameras = catalog.task_descriptions()[self.task].cameras
            self._process = Process(self.task, replace(VIEW, cameras=cameras))
        try:
            answer = self._process.ask({"check": check.name}, self._limit_s)
        except ChildEnded as error:
            return self._failed(check, "the process to survive", str(error), check.look)
        except ChildTimeout as error:
            return self._failed(check, f"an answer within {self._limit_s:g} s", "none", str(error))
        return [CheckResult(**{**result, "outcome": Outcome(result["outcome"])}) for result in answer]

    def _failed(self, check: Check, expected: str, seen: str, look: str) -> list[CheckResult]:
        self.close()
        self._crashes += 1
        return [CheckResult(check.name, self.task, Outcome.FAILED, expected, seen, look)]

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()
            self._process = None


class TaskCheckers:
    """One checker at a time: checks of a task share a process, tasks do not."""

    def __init__(self) -> None:
        self._current: TaskChecker | None = None

    def for_task(self, task: str) -> TaskChecker:
        """Return the checker of the task, after closing that of another task."""
        if self._current is None or self._current.task != task:
            self.close()
            self._current = TaskChecker(task)
        return self._current

    def close(self) -> None:
        """Close the current checker."""
        if self._current is not None:
            self._current.close()
            self._current = None


def default_tasks(simulator: Simulator) -> list[str]:
    """Return the tasks that are checked by default: all if they are few, else some, evenly spread."""
    names = [f"{simulator.name}/{task}" for task in simulator.tasks]
    if len(names) <= MAX_TASKS:
        return names
    return [names[round(i * (len(names) - 1) / (MAX_TASKS - 1))] for i in range(MAX_TASKS)]


def checks_for(tasks: Sequence[str], checks: Iterable[Check], *, every: bool) -> dict[str, list[Check]]:
    """Return the checks of each task: a check for which one task is enough runs on the first only, unless `every`."""
    planned = list(checks)
    return {task: [check for check in planned if every or task == tasks[0] or not check.once] for task in tasks}


def run_checks(
    planned: Mapping[str, Sequence[Check]],
    *,
    limit_s: float = TIME_LIMIT_S,
    on_result: Callable[[CheckResult], None] = lambda result: None,
) -> list[CheckResult]:
    """Run checks on tasks, as many tasks at the same time as there are cores, at most two.

    Args:
        planned: Checks of each `simulator/task`, all of which the catalog knows.
        limit_s: Time limit for each check (s).
        on_result: Called with each result as soon as it exists, from any thread.
    """

    def run_task(task: str) -> list[CheckResult]:
        checker = TaskChecker(task, limit_s)
        results = []
        try:
            for check in planned[task]:
                for result in checker.run(check):
                    on_result(result)
                    results.append(result)
        finally:
            checker.close()
        return results

    with ThreadPoolExecutor(max_workers=min(2, len(os.sched_getaffinity(0)))) as pool:
        return [result for results in pool.map(run_task, planned) for result in results]
