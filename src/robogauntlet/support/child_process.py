"""Child processes that answer requests, in lines of JSON."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

from robogauntlet.support.errors import last_line
from robogauntlet.support.json_text import parse_json
from robogauntlet.support.secret_variables import without_secrets

MAX_ANSWER_BYTES = 64 * 2**20
"""Largest answer of a process."""
LOOK_S = 1.0
"""Time between checks that a process is alive (s)."""
END_S = 10.0
"""Time that a process has to exit after it closed its answers (s)."""


class ChildEnded(Exception):
    """The process exited before it answered, or answered with something else than JSON; the message says how."""


class ChildTimeout(Exception):
    """The process did not answer in time; it is still running."""


class JsonChild:
    """A process that reads requests from its standard input and writes answers to a separate pipe, a line each.

    Its last argument is the file descriptor of the pipe, so that printed text is not mistaken for an answer. If it
    exits, the last line of its standard error is reported. A context manager, which kills it at the end of the block.
    """

    def __init__(
        self, command: Sequence[str], *, environment: Mapping[str, str] | None = None, own_group: bool = False
    ) -> None:
        """Start the process.

        Args:
            command: Interpreter, script and arguments.
            environment: Environment variables; by default those of this process, without secrets.
            own_group: Whether it leads a process group, which is killed with it and does not receive Ctrl-C.

        Raises:
            OSError: The process cannot be started.
        """
        chosen = without_secrets(os.environ) if environment is None else environment
        self._answers, write_end = os.pipe()
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115  closed in close
        try:
            self._process = subprocess.Popen(
                [*command, str(write_end)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self._stderr,
                env={**chosen, "PYTHONSAFEPATH": "1"},  # the working folder may have a module named as one of Python's
                pass_fds=(write_end,),
                bufsize=0,
                start_new_session=own_group,
            )
        except BaseException:
            os.close(self._answers)
            self._stderr.close()
            raise
        finally:
            os.close(write_end)
        assert self._process.stdin is not None
        os.set_blocking(self._process.stdin.fileno(), False)
        self._own_group, self._unread = own_group, bytearray()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Kill it."""
        self.close()

    def __del__(self) -> None:
        """Kill it, if it was not closed."""
        with contextlib.suppress(Exception):
            self.close()

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    @property
    def stderr(self) -> str:
        """Its standard error so far."""
        self._stderr.seek(0)
        return self._stderr.read().decode(errors="replace")

    def ask(self, request: object, limit_s: float) -> Any:
        """Send a request and return the answer.

        Args:
            request: Any JSON value.
            limit_s: Time limit of the answer (s).

        Raises:
            ChildEnded: The process exited, or answered with something else than JSON.
            ChildTimeout: The time limit was exceeded.
        """
        deadline = time.monotonic() + limit_s
        with contextlib.suppress(BrokenPipeError):  # it exited; `receive` raises the reason
            self._send(json.dumps(request).encode() + b"\n", deadline, limit_s)
        return self._receive(deadline, limit_s)

    def receive(self, limit_s: float) -> Any:
        """Return its next answer; see `ask`."""
        return self._receive(time.monotonic() + limit_s, limit_s)

    def _send(self, line: bytes, deadline: float, limit_s: float) -> None:
        """Write a request, which a process that reads nothing may never take."""
        assert self._process.stdin is not None
        rest, pipe = memoryview(line), self._process.stdin.fileno()
        while rest:
            _, ready, _ = select.select([], [pipe], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                raise ChildTimeout(f"the process did not take its request within {limit_s:g} s")
            rest = rest[os.write(pipe, rest[: 1 << 16]) :]

    def _receive(self, deadline: float, limit_s: float) -> Any:
        end = self._unread.find(b"\n")
        while end < 0:
            left_s = max(0.0, deadline - time.monotonic())
            ended = not self.alive  # asked besides the pipe, which a process that it has forked may hold open
            ready, _, _ = select.select([self._answers], [], [], 0.0 if ended else min(LOOK_S, left_s))
            if not ready and not ended and left_s > LOOK_S:
                continue
            if not ready and not ended:
                raise ChildTimeout(f"the process did not answer within {limit_s:g} s")
            read = os.read(self._answers, 1 << 16) if ready else b""
            if not read:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._process.wait(END_S)
                self.kill()
                raise ChildEnded(self._how_it_ended())
            known = len(self._unread)
            self._unread += read
            end = self._unread.find(b"\n", known)
            if len(self._unread) > MAX_ANSWER_BYTES:
                self.kill()
                raise ChildEnded(f"expected an answer of {MAX_ANSWER_BYTES >> 20} MiB at most, the process sent more")
        line = bytes(self._unread[:end])
        del self._unread[: end + 1]
        try:
            return parse_json(line)
        except ValueError:
            self.kill()
            raise ChildEnded(
                f"expected an answer in JSON, the process sent {line[:60].decode(errors='replace')!a}"
            ) from None

    def kill(self) -> None:
        """Kill it, and its group if it leads one."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            if self._own_group:
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                self._process.kill()
        self._process.wait()

    def close(self, grace_s: float = 0.0) -> None:
        """Close its standard input, wait for it to exit (s), and kill it. May be called twice."""
        if self._stderr.closed:
            return
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        if grace_s:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(grace_s)
        self.kill()
        os.close(self._answers)
        self._stderr.close()

    def _how_it_ended(self) -> str:
        code, last = self._process.returncode, last_line(self.stderr)
        if code < 0:
            return f"the process was killed by {signal.Signals(-code).name}: {last}"
        return f"the process ended with code {code}: {last}"


def serve(answer: Callable[[Any], object]) -> None:
    """Answer requests until there are no more; called in the child process."""
    with os.fdopen(int(sys.argv[-1]), "w") as answers:
        for line in sys.stdin:
            answers.write(json.dumps(answer(json.loads(line))) + "\n")
            answers.flush()
