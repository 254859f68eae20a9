"""Child processes that run checks, so that a crash or a hang becomes a result."""

from __future__ import annotations

import json
import re
import signal
import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.suites.episode import View
from robogauntlet.support.child_process import ChildTimeout, JsonChild

TIME_LIMIT_S = 120.0
"""Time for one check, and for opening the task before the first (s)."""
CLOSE_S = 10.0
"""Time for closing the task, and for printing the stack of a hang (s)."""
WHERE = re.compile(r'File "(?P<file>[^"]+)", line (?P<line>\d+) in (?P<name>\S+)')


class Process(JsonChild):
    """A child process with one task, see `checks/child.py`."""

    def __init__(self, task: str, view: View, *, group: bool = True) -> None:
        """Start it.

        Args:
            task: `simulator/task`.
            view: Cameras and image size.
            group: Whether it leads a process group that is killed with it; otherwise it joins the caller's.
        """
        python, environment = EnvironmentResolver().subprocess_env(catalog.find(task.partition("/")[0]))
        command = [python, "-m", "robogauntlet.orchestrator.adapter_kit.checks.child", task, json.dumps(asdict(view))]
        super().__init__(command, environment=environment, own_group=group)

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

    def close(self, grace_s: float = CLOSE_S) -> None:
        """Let the process close its task and end, then kill the rest of its group."""
        super().close(grace_s)

    def _where(self) -> str:
        """Return where the process is now, from the stack that it prints on a signal."""
        before = len(self.stderr)
        self._process.send_signal(signal.SIGUSR1)
        deadline = time.monotonic() + CLOSE_S
        while self.alive and time.monotonic() < deadline:
            if found := WHERE.search(self.stderr[before:]):
                return f"{found['file']}:{found['line']} in {found['name']}"
            time.sleep(0.05)
        return "an unknown place"


def ask_new_process(task: str, view: View, request: Mapping[str, Any]) -> Any:
    """Return the answer of a new process.

    Raises:
        ChildEnded: The process died.
        ChildTimeout: The answer took too long.
    """
    with Process(task, view, group=False) as process:
        return process.ask(request)
