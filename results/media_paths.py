"""Where a run folder keeps its pictures and videos."""

from __future__ import annotations

from pathlib import Path

from robogauntlet.suites.episode import Condition

MEDIA = "media"


def videos_folder(folder: Path) -> Path:
    """Where a run keeps its videos, each named after its episode."""
    return folder / MEDIA / "videos"


def video_path(folder: Path, episode_id: str) -> Path:
    """Where a run keeps the video of an episode (mp4)."""
    return videos_folder(folder) / f"{episode_id}.mp4"


def picture_path(folder: Path, task: str) -> Path:
    """Where a run keeps the picture of a task (PNG)."""
    return folder / MEDIA / "pictures" / f"{_named(task)}.png"


def snapshot_path(folder: Path, task: str, condition: Condition) -> Path:
    """Where a run keeps what policies see first of a task under a condition, cameras side by side (PNG)."""
    return folder / MEDIA / "looks" / f"{_named(task)}@{condition.axis}@{condition.severity}.png"


def _named(task: str) -> str:
    return task.replace("/", "__")
