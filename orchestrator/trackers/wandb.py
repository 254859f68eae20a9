"""Sends a run to Weights & Biases, or, with WANDB_MODE=offline, writes files for `wandb sync`.

Login, server and offline mode are W&B's own settings (`wandb login`, WANDB_API_KEY, WANDB_MODE, WANDB_DIR). W&B's own
records of program, machine and repository are disabled.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from robogauntlet.orchestrator.trackers.tracked_run import COLUMNS, TrackedRun, TrackerError
from robogauntlet.orchestrator.trackers.tracker import TrackedVideo


class WandbSession:
    """One run that is open in W&B.

    The step of a metric is the time since the run was created (s): a continued run goes on behind its last step, also
    offline, where W&B does not know it.
    """

    def __init__(self, wandb: ModuleType, run: Any, started_at: float) -> None:
        self._wandb, self._run, self._started_at, self._step = wandb, run, started_at, -1
        self.address = f"upload it with: wandb sync {run.settings.sync_dir}" if run.offline else str(run.url)

    def log_progress(self, metrics: Mapping[str, float]) -> None:
        """Add the metrics of one moment of the run."""
        with _refusals():
            self._log(dict(metrics))

    def conclude(self, run: TrackedRun) -> None:
        """Write the results of the run."""
        with _refusals():
            self._run.config.update(run.state, allow_val_change=True)
            cells = self._wandb.Table(columns=list(COLUMNS), data=[list(row) for row in run.rows])
            self._log({**run.metrics, "cells": cells})

    def add_videos(self, videos: Sequence[TrackedVideo]) -> None:
        """Add videos."""
        with _refusals():
            found = {f"videos/{video.name}": self._wandb.Video(video.path, format="mp4") for video in videos}
            self._log(found)

    def finish(self) -> None:
        """Wait until everything is written."""
        with _refusals():
            self._run.finish()

    def _log(self, values: dict[str, Any]) -> None:
        self._step = max(self._step + 1, int(time.time() - self._started_at))
        self._run.log(values, step=self._step, commit=True)


def check() -> None:
    """Raise TrackerError if W&B or its login is missing."""
    wandb = _library()
    with _refusals():
        offline = wandb.setup().settings.mode in ("offline", "dryrun", "disabled")
        ready = offline or wandb.login(prompt=False, verify=False)
    if not ready:
        raise TrackerError("W&B has no login; log in with `wandb login`, or write files with WANDB_MODE=offline")


def open_session(run: TrackedRun, *, name: str, project: str) -> WandbSession:
    """Create the run in W&B, or continue the one of the same id."""
    wandb = _library()
    with _refusals():
        settings = wandb.Settings(
            silent=True,
            console="off",
            disable_git=True,
            disable_code=True,
            x_disable_machine_info=True,
            x_disable_meta=True,
            x_disable_stats=True,
            x_save_requirements=False,
            init_timeout=30,
        )
        opened = wandb.init(
            project=project,
            name=name,
            id=run.run_id,
            resume="allow",
            config={**run.provenance, **run.state},
            tags=list(run.tags),
            settings=settings,
        )
        return WandbSession(wandb, opened, run.started_at)


@contextmanager
def _refusals() -> Iterator[None]:
    """Exceptions of the library as TrackerError."""
    try:
        yield
        return
    except Exception as error:  # its text may contain the API key
        problem = f"W&B did not accept the run ({type(error).__name__}); log in with `wandb login`, check --project, "
    raise TrackerError(f"{problem}or write files with WANDB_MODE=offline")


def _library() -> ModuleType:
    os.environ.setdefault("WANDB_ERROR_REPORTING", "false")  # no crash reports to W&B
    try:
        import wandb
    except ImportError:
        raise TrackerError('W&B is not installed; install it with: pip install "robogauntlet[wandb]"') from None
    return wandb
