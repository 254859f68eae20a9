"""Processes in which checks are played: one that crashes or hangs is a finding, not the end."""

from __future__ import annotations

import contextlib
import json
import os
import re
import select
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from adapters import catalog
from orchestrator.environments.homes import Homes
from suites.vocabulary import View

TIME_LIMIT_S = 120.0
"""For one check, opening included where it comes first."""
FAREWELL_S = 10.0
"""For closing, and for saying where it hangs."""
WHERE = re.compile(r'File "(?P<file>[^"]+)", line (?P<line>\d+) in (?P<name>\S+)')


class Ended(Exception):
    """The process ended before it answered; the message says how."""


class Hung(Exception):
    """The process did not answer in time and was ended; the message says where it was, as far as it is known."""


class Process:
    """A Python process that has a task to itself and answers requests, see `orchestrator.conformance.child`."""

    def __init__(self, task: str, view: View, *, group: bool = True) -> None:
        """Start it.

        Args:
            task: `simulator/task`.
            view: What it renders.
            group: Whether it leads a group of processes, which is ended with it; else it belongs to the caller's.
        """
        python, environment = Homes().child(catalog.find(task.partition("/")[0]))
        answers, write_end = os.pipe()
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  closed in close
        shown = json.dumps(asdict(view))
        command = [python, "-m", "orchestrator.conformance.child", task, shown, str(write_end)]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=self._said,
            stderr=self._said,
            env=environment,
            pass_fds=(write_end,),
            start_new_session=group,
        )
        os.close(write_end)
        self._group, self._answers, self._unread = group, answers, b""

    def ask(self, request: Mapping[str, Any], limit_s: float = TIME_LIMIT_S) -> Any:
        """Its answer to a request, both as JSON has them.

        Raises:
            Ended: It died.
            Hung: It took longer than the limit, and was killed.
        """
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it has died; reading says how
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        deadline = time.monotonic() + limit_s
        while b"\n" not in self._unread:
            ready, _, _ = select.select([self._answers], [], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                where = self._where()
                self._kill()
                raise Hung(where)
            read = os.read(self._answers, 1 << 16)
            if not read:
                raise Ended(self._how_it_ended())
            self._unread += read
        line, _, self._unread = self._unread.partition(b"\n")
        return json.loads(line)

    def close(self) -> None:
        """Let it close its task and end; what is left of its group is killed."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(FAREWELL_S)
        self._kill()
        os.close(self._answers)
        self._said.close()

    def _kill(self) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            if self._group:
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                self._process.kill()
        self._process.wait()

    def _how_it_ended(self) -> str:
        try:
            code = self._process.wait(FAREWELL_S)
        except subprocess.TimeoutExpired:
            return "its answers ended"
        if code < 0:
            return f"the process was killed by {signal.Signals(-code).name}"
        last = (self._output().splitlines() or ["nothing was printed"])[-1]
        return f"the process ended with code {code}: {last}"

    def _where(self) -> str:
        """Where it is now, by the stack that it prints when it is told to."""
        before = len(self._output())
        self._process.send_signal(signal.SIGUSR1)
        deadline = time.monotonic() + FAREWELL_S
        while time.monotonic() < deadline:
            found = WHERE.search(self._output()[before:])
            if found:
                return f"{found['file']}:{found['line']} in {found['name']}"
            if self._process.poll() is not None:
                break
            time.sleep(0.05)
        return "it does not say where"

    def _output(self) -> str:
        self._said.seek(0)
        return self._said.read().decode(errors="replace").strip()


def ask_elsewhere(task: str, view: View, request: Mapping[str, Any]) -> Any:
    """What another, fresh process answers.

    Raises:
        Ended: It died.
        Hung: It took too long.
    """
    process = Process(task, view, group=False)
    try:
        return process.ask(request)
    finally:
        process.close()
