"""Paths of the pictures and videos of a run."""

from __future__ import annotations

import re
from pathlib import Path

from robogauntlet.suites.episode import Condition

MEDIA = "media"
_FILE = re.compile(r"media/(videos/[^/\\]+\.mp4|(pictures|snapshots)/[^/\\]+\.png)")
SHARED_BY = ("pair_id", "state_hash", "actions_hash", "final_state_hash")
"""Fields of a row that are equal for policies that acted identically, so that one video shows the episodes of all."""


def _name(text: str) -> str:
    """A part of a file's name, which stays in its folder whatever a row of others holds."""
    return text.replace("/", "__").replace("\0", "")


def videos_folder(folder: Path) -> Path:
    """Return the folder with a run's videos."""
    return folder / MEDIA / "videos"


def begun_folder(folder: Path) -> Path:
    """Return the folder of unfinished videos while a run plays."""
    return videos_folder(folder) / ".begun"


def video_path(folder: Path, episode_id: str) -> Path:
    """Return the path of the video of an episode (mp4)."""
    return videos_folder(folder) / f"{_name(episode_id)}.mp4"


def picture_path(folder: Path, task: str) -> Path:
    """Return the path of the picture of a task (PNG)."""
    return folder / MEDIA / "pictures" / f"{_name(task)}.png"


def snapshot_path(folder: Path, task: str, condition: Condition) -> Path:
    """Return the path of the first observation of a task under a condition, cameras side by side (PNG)."""
    return folder / MEDIA / "snapshots" / f"{_name(f'{task}@{condition.axis}@{condition.severity}')}.png"


def is_media(name: str) -> bool:
    """Whether a run may have a video or picture of this path in its folder."""
    return bool(_FILE.fullmatch(name)) and name.isprintable()


def is_own_file(folder: Path, path: Path) -> bool:
    """Whether a path is a file of the run folder: no device or pipe, and no link to the reader's own files."""
    try:
        return path.is_file() and path.resolve(strict=True).is_relative_to(folder.resolve(strict=True))
    except (OSError, RuntimeError):  # links in a circle
        return False


def media_files(folder: Path) -> dict[str, Path]:
    """Return the videos and pictures of a run by their path in its folder."""
    found = {path.relative_to(folder).as_posix(): path for path in sorted((folder / MEDIA).glob("*/*"))}
    return {name: path for name, path in found.items() if is_media(name) and is_own_file(folder, path)}
