"""Sends a run to Weights & Biases, or, with WANDB_MODE=offline, writes files for `wandb sync`.

Login, server and offline mode are W&B's own settings (`wandb login`, WANDB_API_KEY, WANDB_MODE, WANDB_DIR). W&B's own
records of program, machine and repository are disabled. Its own process sends what is logged, so only opening the run
and finishing it wait for the server.
"""

from __future__ import annotations

import io
import os
import time
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr
from types import ModuleType
from typing import Any

from robogauntlet.orchestrator.trackers.tracked_run import COLUMNS, TrackedRun, TrackerError
from robogauntlet.orchestrator.trackers.tracker import Tracker, TrackerName
from robogauntlet.orchestrator.trackers.videos import TrackedVideo

OPEN_S = 15.0
"""Longest time that the run waits for W&B when it is opened (s)."""
FINISH_S = 15.0
"""The same when it is finished."""


class WandbTracker(Tracker):
    """One run in W&B."""

    name = TrackerName.WANDB
    label = "W&B"
    advice = "log in with `wandb login`, check --project, or write files with WANDB_MODE=offline"
    _run: Any
    _started_at = 0.0
    _step = -1

    def check(self) -> None:
        """See `Tracker`."""
        self._wandb = _library()
        with self._refusals():
            offline = self._wandb.setup().settings.mode in ("offline", "dryrun", "disabled")
            with redirect_stderr(io.StringIO()):  # where the login comes from
                ready = offline or self._wandb.login(prompt=False, verify=False)
        if not ready:
            raise TrackerError("W&B has no login; log in with `wandb login`, or write files with WANDB_MODE=offline")

    def open(self, run: TrackedRun, name: str) -> str:
        """See `Tracker`."""
        settings = self._wandb.Settings(
            silent=True,
            console="off",
            disable_git=True,
            disable_code=True,
            x_disable_machine_info=True,
            x_disable_meta=True,
            x_disable_stats=True,
            x_save_requirements=False,
            init_timeout=OPEN_S,
            finish_timeout=FINISH_S,
            finish_timeout_raises=True,
            reinit="create_new",  # beside a run of the user's own
        )
        self._started_at = run.started_at
        self._run = self._wandb.init(
            project=self._project,
            name=name,
            id=run.run_id,
            resume="allow",
            config={**run.provenance, **run.state},
            tags=list(run.tags),
            settings=settings,
        )
        return f"upload it with: wandb sync {self._run.settings.sync_dir}" if self._run.offline else str(self._run.url)

    def log(self, metrics: Mapping[str, Any]) -> None:
        """See `Tracker`."""
        self._step = max(self._step + 1, int(time.time() - self._started_at))
        self._run.log(dict(metrics), step=self._step, commit=True)

    def conclude(self, run: TrackedRun) -> None:
        """See `Tracker`."""
        self._run.config.update(run.state, allow_val_change=True)
        cells = self._wandb.Table(columns=list(COLUMNS), data=[list(row) for row in run.rows])
        self.log({**run.metrics, "cells": cells})

    def add_videos(self, videos: Sequence[TrackedVideo]) -> None:
        """See `Tracker`."""
        self.log({f"videos/{video.name}": self._wandb.Video(video.path, format="mp4") for video in videos})

    def finish(self) -> None:
        """See `Tracker`."""
        self._run.finish()


def _library() -> ModuleType:
    os.environ.setdefault("WANDB_ERROR_REPORTING", "false")  # no crash reports to W&B
    try:
        import wandb
    except ImportError:
        raise TrackerError('W&B is not installed; install it with: pip install "robogauntlet[wandb]"') from None
    return wandb
