"""A process of its own for what is checked, in which a crash, a hang or a leak becomes a finding."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Mapping
from typing import Any

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.support.child_process import ChildTimeout, JsonChild

CLOSE_S = 10.0
"""Time for closing a task, and for printing the stack of a hang (s)."""
WHERE = re.compile(r'File "(?P<file>[^"]+)", line (?P<line>\d+) in (?P<name>\S+)')


class CheckProcess(JsonChild):
    """A process in a simulator's environment that runs a module of this package, which answers requests."""

    def __init__(
        self, task: str, module: str, *, variables: Mapping[str, str] | None = None, own_group: bool = True
    ) -> None:
        """Start it for `simulator/task`, with further variables, by default at the head of a process group."""
        python, environment = EnvironmentResolver().subprocess_env(catalog.find(task.partition("/")[0]))
        command = [python, "-m", f"robogauntlet.orchestrator.kit.{module}", task]
        super().__init__(command, environment={**environment, **(variables or {})}, own_group=own_group)

    def ask(self, request: object, limit_s: float) -> Any:
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
