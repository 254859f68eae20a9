"""Experiment trackers (Weights & Biases, MLflow), to which the results of a run are sent. See docs/notifications.md.

Each tracker is a module with `log_run(document, tables, *, name, project) -> str`, which imports the tracker's library
when it is called. All trackers receive the same `TrackedRun`.
"""

from robogauntlet.orchestrator.trackers.tracked_run import TrackerError

__all__ = ["TrackerError"]
