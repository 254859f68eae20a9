"""Experiment trackers (Weights & Biases, MLflow), to which a run is sent. See docs/notifications.md and docs/runs.md.

Each tracker is a module with the functions of `tracker.TrackerModule`. `robogauntlet log` sends a finished run with
`tracker.log_run`. While a run plays, `live_tracker.LiveTracker` sends it through a child process (`tracker_process`).
"""

from robogauntlet.orchestrator.trackers.tracked_run import TrackerError

__all__ = ["TrackerError"]
