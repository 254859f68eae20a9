"""The child process that sends a run to an experiment tracker while it plays, one request after another.

The tracker's library is imported here only, so that its threads, its printing and its crashes stay out of the run.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from typing import Any

from robogauntlet.orchestrator.trackers.tracked_run import TrackedRun, TrackerError
from robogauntlet.orchestrator.trackers.tracker import TrackedVideo, Tracker, TrackerSession, module_of
from robogauntlet.support.child_process import serve

WATCH_S = 1.0
"""Time between two checks that the run still exists (s)."""


class TrackerProcess:
    """Answers the requests of `LiveTracker` with an address, or with a problem in one line."""

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self._session: TrackerSession | None = None

    def answer(self, request: dict[str, Any]) -> dict[str, str | None]:
        """Do what is requested."""
        try:
            self._do(request)
        except TrackerError as error:
            return {"problem": str(error)}
        except Exception as error:  # its text may contain secrets
            return {"problem": f"{type(error).__name__} in the process of {self._tracker.label}"}
        return {"address": self._session.address if self._session else None}

    def _do(self, request: dict[str, Any]) -> None:
        module, action = module_of(self._tracker), request["do"]
        if action == "check":
            module.check()
        elif action == "open":
            run = TrackedRun(**request["run"])
            self._session = module.open_session(run, name=request["name"], project=request["project"])
        elif self._session is None:
            raise TrackerError(f"{self._tracker.label} has not opened the run")
        elif action == "progress":
            self._session.log_progress(request["metrics"])
        elif action == "conclude":
            self._session.conclude(TrackedRun(**request["run"]))
        elif action == "videos":
            self._session.add_videos([TrackedVideo(**video) for video in request["videos"]])
        else:
            self._session.finish()


def _end_with(parent: int) -> None:
    """End this process when the run's process is gone, even while a library hangs."""
    while os.getppid() == parent:
        time.sleep(WATCH_S)
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    serve(TrackerProcess(Tracker(sys.argv[1])).answer)
