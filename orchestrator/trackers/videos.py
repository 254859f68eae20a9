"""Selects the recorded videos of a run that an experiment tracker receives."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from robogauntlet.orchestrator.replay.media_selection import recording_order, representative_episodes, shared_by
from robogauntlet.results.media_paths import video_path, videos_folder
from robogauntlet.results.record import EpisodeResult

MOST_VIDEOS = 40
MOST_BYTES = 32 * 2**20
"""Size of all videos together."""
_UNSAFE = re.compile(r"[^A-Za-z0-9_.\-]+")


@dataclass(frozen=True)
class TrackedVideo:
    """A recorded episode."""

    name: str
    """`POLICY/TASK/STATUS`, in characters that every tracker accepts."""
    path: str
    """The mp4 file."""


def tracked_videos(folder: Path, rows: Callable[[], Iterable[EpisodeResult]]) -> list[TrackedVideo]:
    """Return a success and a failure per policy and task, as far as recorded, at most `MOST_VIDEOS` and `MOST_BYTES`.

    `rows` returns a new iterator over the run's rows at every call. Policies that acted identically share a video.
    """
    files = {path.stem for path in videos_folder(folder).glob("*.mp4")}
    if not files:
        return []
    recorded = {shared_by(row): row.episode_id for row in rows() if row.episode_id in files}
    chosen: list[TrackedVideo] = []
    left = MOST_BYTES
    shown = representative_episodes(row for row in rows() if shared_by(row) in recorded)
    order = {shared_by(row): place for place, row in enumerate(recording_order(shown))}
    for row in sorted(shown, key=lambda row: order[shared_by(row)]):
        path = video_path(folder, recorded[shared_by(row)]).absolute()
        if (size := path.stat().st_size) <= left and len(chosen) < MOST_VIDEOS:
            left -= size
            place = "/".join(_UNSAFE.sub("_", part) for part in (row.policy, *row.task.split("/"), str(row.status)))
            chosen.append(TrackedVideo(place, str(path)))
    return chosen
