"""Runs checks on the tasks of an adapter, each in a child process, so that a crash or a hang becomes a result."""

from __future__ import annotations

import json
import os
import re
import signal
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict, replace
from itertools import chain
from typing import Any

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulator
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.kit.adapter.check import Check, CheckResult, Outcome
from robogauntlet.orchestrator.kit.adapter.checked_task import VIEW
from robogauntlet.suites.episode import View
from robogauntlet.support.child_process import ChildEnded, ChildTimeout, JsonChild

TIME_LIMIT_S = 120.0
"""Time for one check, and for opening the task before the first (s)."""
CLOSE_S = 10.0
"""Time for closing the task, and for printing the stack of a hang (s)."""
WHERE = re.compile(r'File "(?P<file>[^"]+)", line (?P<line>\d+) in (?P<name>\S+)')
MAX_TASKS = 3
"""Tasks of a simulator that are checked by default."""
MAX_CRASHES = 3
"""Crashes or hangs of a task after which the other checks are skipped."""


class Process(JsonChild):
    """A child process with one `simulator/task`, see `checks/child.py`."""

    def __init__(self, task: str, view: View, *, own_group: bool = True) -> None:
        """Start it, by default at the head of a process group that is killed with it."""
        python, environment = EnvironmentResolver().subprocess_env(catalog.find(task.partition("/")[0]))
        command = [python, "-m", "robogauntlet.orchestrator.kit.adapter.child", task, json.dumps(asdict(view))]
        super().__init__(command, environment=environment, own_group=own_group)

    def ask(self, request: object, limit_s: float = TIME_LIMIT_S) -> Any:
        """Send a request and return the answer.

        Raises:
            ChildEnded: The process died.
            ChildTimeout: The process exceeded the limit and was killed; the message says where it was.
        """
        try:
            return super().ask(request, limit_s)
        except ChildTimeout:
            where = self._where()
            self.kill()
            raise ChildTimeout(where) from None

    def _where(self) -> str:
        """Return where the process is now, from the stack that it prints on a signal."""
        before = len(self.stderr)
        self._process.send_signal(signal.SIGUSR1)
        deadline = time.monotonic() + CLOSE_S
        while self.alive and time.monotonic() < deadline:
            if match := WHERE.search(self.stderr[before:]):
                return f"{match['file']}:{match['line']} in {match['name']}"
            time.sleep(0.05)
        return "an unknown place"


def ask_new_process(task: str, view: View, request: Mapping[str, Any]) -> Any:
    """Return the answer of a new process; raises as `Process.ask`."""
    process = Process(task, view, own_group=False)
    try:
        return process.ask(request)
    finally:
        process.close(CLOSE_S)


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
            self._process.close(CLOSE_S)
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
    on_result: Callable[[CheckResult], None] = lambda result: None,
) -> list[CheckResult]:
    """Run checks on tasks, as many tasks at the same time as there are cores, at most two.

    Args:
        planned: Checks of each `simulator/task`, all of which the catalog knows.
        limit_s: Time limit for each check (s).
        on_result: Called with each result as soon as it exists, from any thread.
    """

    def run_task(task: str) -> list[CheckResult]:
        results = []
        with closing(TaskChecker(task, limit_s)) as checker:
            for result in chain.from_iterable(map(checker.run, planned[task])):
                on_result(result)
                results.append(result)
        return results

    with ThreadPoolExecutor(max_workers=min(2, len(os.sched_getaffinity(0)))) as pool:
        return [result for results in pool.map(run_task, planned) for result in results]
