"""Experiment trackers (Weights & Biases, MLflow), to which the results of a run are sent. See docs/notifications.md.

Each tracker is a module with a function `log_run(document, tables, *, name, project) -> str`. It sends the `TrackedRun`
of a run's document and tables under a displayed name to a project, and returns where the run is. A run that was sent
before is updated. It raises TrackerError if the tracker's library is missing or refuses the run.
"""

from robogauntlet.orchestrator.trackers.tracked_run import TrackerError

__all__ = ["TrackerError"]
