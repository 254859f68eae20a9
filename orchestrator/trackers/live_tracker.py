"""Sends a run to an experiment tracker while it plays. Whatever the tracker does, the run goes on."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

from robogauntlet.orchestrator.trackers.tracked_run import TrackedRun, TrackerError, check_project
from robogauntlet.orchestrator.trackers.tracker import PROJECT, TrackedVideo, Tracker
from robogauntlet.support.child_process import ChildEnded, ChildTimeout, JsonChild
from robogauntlet.support.secret_variables import TRACKER_SECRETS, is_secret

UPDATE_S = 30.0
"""Shortest time between two updates (s)."""
ANSWER_S = 60.0
"""Time after which a request counts as unanswered (s)."""
END_S = 15.0
"""Longest time that a run waits at its end until the tracker has everything (s)."""
KILL_S = 1.0


class LiveTracker:
    """One run in an experiment tracker, through a child process, which alone gets the tracker's secrets.

    A thread sends one request after another. Progress that the tracker has not taken is replaced by newer progress,
    so that nothing accumulates. The first problem becomes a warning. A tracker that does not answer, and one whose
    process has ended, gets nothing more. A context manager, which kills the process at the end of the block.
    """

    def __init__(self, tracker: Tracker, project: str = PROJECT) -> None:
        """Start the process and check that the tracker can be used on this machine. No server is contacted.

        Raises:
            TrackerError: The project's name is unusable, or the tracker's library or login is missing.
        """
        check_project(project)
        self._tracker, self._project, self._folder = tracker, project, "RUN"
        self.address: str | None = None
        """Where the run is, once it is open."""
        self.complete = False
        self._lacks_results = False
        """Whether the tracker has the results and the videos."""
        self._warning: str | None = None
        self._warned = self._closing = False
        self._progress: dict[str, float] | None = None
        self._requests: list[dict[str, Any]] = []
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._updated = -UPDATE_S
        self._child: JsonChild | None = None
        try:
            self._child = self._start()
            problem = self._child.ask({"do": "check"}, ANSWER_S).get("problem")
        except (OSError, ChildEnded, ChildTimeout) as error:
            self._give_up(f"{tracker.label}: {error}")
            return
        if problem is not None:
            self._child.close()
            raise TrackerError(problem)

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Kill the process."""
        self._kill()

    def open(self, run: TrackedRun, name: str, folder: str) -> None:
        """Create or continue the run in the tracker, under a displayed name; `folder` is its run folder."""
        self._folder = folder
        if self._child is not None:
            fields = dataclasses.asdict(run)
            self._requests.append({"do": "open", "run": fields, "name": name, "project": self._project})
            self._thread = threading.Thread(target=self._send_all, name="experiment tracker", daemon=True)
            self._thread.start()

    def update(self, metrics: Callable[[], Mapping[str, float]]) -> None:
        """Send metrics, unless the last ones were sent less than `UPDATE_S` ago. Returns at once."""
        now = time.monotonic()
        if now - self._updated < UPDATE_S or self._thread is None or not self._thread.is_alive():
            return
        self._updated = now
        with self._changed:
            self._progress = dict(metrics())
            self._changed.notify()

    def conclude(self, run: TrackedRun | None, metrics: Mapping[str, float]) -> None:
        """Send the last progress and the results, as `robogauntlet log` does. Returns at once."""
        self._request({"do": "progress", "metrics": dict(metrics)})
        if run is not None:
            self._request({"do": "conclude", "run": dataclasses.asdict(run)})
        else:
            self._warn("the results could not be computed")
            self._lacks_results = True

    def finish(self, videos: Sequence[TrackedVideo]) -> None:
        """Send videos and wait until the tracker has everything, for at most `END_S`."""
        if videos:
            self._request({"do": "videos", "videos": [dataclasses.asdict(video) for video in videos]})
        self._request({"do": "finish"})
        with self._changed:
            self._closing = True
            self._changed.notify()
        if self._thread is not None:
            try:
                self._thread.join(END_S)
            except KeyboardInterrupt:  # everything else is complete; the results can be sent again
                self._warn(f"{self._tracker.label} was not waited for")
            if self._thread.is_alive():
                self._warn(f"{self._tracker.label} did not take the results within {END_S:g} s")
        self._kill()

    def take_warning(self) -> str | None:
        """The warning, once."""
        with self._changed:
            taken, self._warned = None if self._warned else self._warning, self._warned or self._warning is not None
        return taken

    def _start(self) -> JsonChild:
        command = [sys.executable, "-m", "robogauntlet.orchestrator.trackers.tracker_process", self._tracker.value]
        # It runs the library that the user chose, which may need the login of another service, too: where files go.
        own = TRACKER_SECRETS[self._tracker.value]
        environment = {name: value for name, value in os.environ.items() if name in own or not is_secret(name)}
        return JsonChild(command, environment=environment, own_group=True)

    def _request(self, request: dict[str, Any]) -> None:
        with self._changed:
            self._progress = None  # older than what follows
            self._requests.append(request)
            self._changed.notify()

    def _next(self) -> dict[str, Any] | None:
        """Wait for a request; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._requests or self._progress is not None or self._closing)
            if self._requests:
                return self._requests.pop(0)
            if self._progress is not None:
                metrics, self._progress = self._progress, None
                return {"do": "progress", "metrics": metrics}
        return None

    def _send_all(self) -> None:
        assert self._child is not None
        failed: set[str] = set()
        while (request := self._next()) is not None:
            try:
                answer = self._child.ask(request, ANSWER_S)
                problem = answer.get("problem")
                self.address = answer.get("address") or self.address
            except (OSError, ValueError, ChildEnded, ChildTimeout) as error:
                self._give_up(f"{self._tracker.label}: {error}")
                return
            if problem is None:
                failed.discard(request["do"])
                continue
            failed.add(request["do"])
            self._warn(problem)
            if request["do"] == "open":
                self._give_up(problem)
                return
        self.complete = not failed - {"progress"} and not self._lacks_results

    def _give_up(self, problem: str) -> None:
        self._warn(problem)
        if self._child is not None:
            self._child.kill()

    def _warn(self, problem: str) -> None:
        with self._changed:
            if self._warning is None:
                command = f"robogauntlet log {self._folder} --to {self._tracker} --project {self._project!r}"
                self._warning = f"{problem}; the run goes on, to send its results later: {command}"

    def _kill(self) -> None:
        """Kill the process. The thread then ends, too."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        if self._child is None:
            return
        self._child.kill()
        if self._thread is not None:
            self._thread.join(KILL_S)
        if self._thread is None or not self._thread.is_alive():
            with contextlib.suppress(OSError):
                self._child.close()
