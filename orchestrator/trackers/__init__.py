"""Experiment trackers (Weights & Biases, MLflow), which observe a run. See docs/operating.md."""

from __future__ import annotations

from collections.abc import Callable

from robogauntlet.orchestrator.trackers.tracked_run import TrackerError
from robogauntlet.orchestrator.trackers.tracker import PROJECT, Tracker, TrackerName

__all__ = ["PROJECT", "Tracker", "TrackerError", "TrackerName", "open_tracker"]


def open_tracker(name: str, project: str = PROJECT, say: Callable[[str], None] = lambda line: None) -> Tracker:
    """The tracker of this name; see `Tracker`. Raises TrackerError if there is none, or it cannot be used."""
    if name == TrackerName.WANDB:
        from robogauntlet.orchestrator.trackers.wandb import WandbTracker

        return WandbTracker(project, say)
    if name == TrackerName.MLFLOW:
        from robogauntlet.orchestrator.trackers.mlflow import MlflowTracker

        return MlflowTracker(project, say)
    raise TrackerError(f"tracker: expected an experiment tracker, {' or '.join(TrackerName)}, got {name!r}")
