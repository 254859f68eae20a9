"""Writes a run's numbers into an experiment logger: Weights & Biases, MLflow. See docs/telling.md.

Each logger is a module with `log_run(document, tables, *, name, project) -> str`, which imports its library when it is
called and not before. What is written of a run is made in `entry`, and is the same for all.
"""

from orchestrator.loggers.entry import LoggingError

__all__ = ["LoggingError"]
