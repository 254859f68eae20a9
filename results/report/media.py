"""Pictures and videos of a run, chosen, and made into data URIs so that the report is one file."""

from __future__ import annotations

import base64
import io
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from results.media import picture_path, videos_folder
from results.record import Status
from suites.vocabulary import CLEAN, Condition

if TYPE_CHECKING:
    import pandas as pd

VIDEO_BUDGET = 15_000_000
"""Bytes of video in one report."""
POSTER_SIZE = 256
"""Greatest width and height of a still (px)."""


@dataclass(frozen=True, slots=True)
class Video:
    """A recorded episode that stands for a policy's successes or failures on a task."""

    episode_id: str
    policy_digest: str
    task: str
    status: str
    seed: int
    condition: Condition
    path: Path
    size: int
    """Of the file (bytes)."""
    source: str | None = None
    """Data URI, or None where it was left out for its size."""
    poster: str | None = None
    """Data URI of the last frame, which shows how the episode ended."""


def task_picture(folder: Path, task: str) -> str | None:
    """Data URI of a task's picture, or None if there is none that can be read."""
    try:
        return _still(picture_path(folder, task).read_bytes())
    except OSError:
        return None


def choose_videos(folder: Path, frame: pd.DataFrame, budget: int = VIDEO_BUDGET) -> list[Video]:
    """Per policy and task the first success and the first failure that were filmed: clean ones first, then by seed.

    Args:
        folder: The run folder.
        frame: Rows with the columns `episode_id`, `policy_digest`, `task`, `axis`, `severity`, `seed` and `status`.
        budget: Bytes to embed. If the chosen files are larger together, the smallest come first.

    Returns:
        The chosen videos, embedded or (`source` is None) left out.
    """
    files = {path.stem: path for path in sorted(videos_folder(folder).glob("*.mp4")) if path.is_file()}
    filmed = frame.loc[frame["episode_id"].isin(list(files))]
    filmed = filmed.loc[filmed["status"].astype(str).isin([Status.SUCCESS, Status.FAILURE])]
    filmed = filmed.assign(perturbed=filmed["axis"].astype(str) != CLEAN)
    filmed = filmed.sort_values(["perturbed", "axis", "severity", "seed"], kind="stable")
    first = filmed.drop_duplicates(["policy_digest", "task", "status"])
    chosen = [_video(row, files[row.episode_id]) for row in first.itertuples(index=False)]
    return _embed([video for video in chosen if video.size], budget)


def _video(row: object, path: Path) -> Video:
    value = row.__getattribute__
    return Video(
        episode_id=value("episode_id"),
        policy_digest=str(value("policy_digest")),
        task=str(value("task")),
        status=str(value("status")),
        seed=int(value("seed")),
        condition=Condition(str(value("axis")), int(value("severity"))),
        path=path,
        size=path.stat().st_size,
    )


def _embed(videos: list[Video], budget: int) -> list[Video]:
    fitting: set[str] = set()
    for video in sorted(videos, key=lambda video: (video.size, video.episode_id)):
        budget -= video.size
        if budget < 0:
            break
        fitting.add(video.episode_id)
    return [_embedded(video) if video.episode_id in fitting else video for video in videos]


def _embedded(video: Video) -> Video:
    frame = last_frame(video.path)
    return replace(
        video,
        source=_data_uri("video/mp4", video.path.read_bytes()),
        poster=None if frame is None else _still(frame),
    )


def last_frame(path: Path) -> bytes | None:
    """The last frame of a video as PNG, or None if it cannot be had."""
    import imageio_ffmpeg

    try:
        ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
        # Decodes the last half second and lets each frame overwrite the one before it.
        command = [ffmpeg, "-v", "error", "-sseof", "-0.5", "-i", str(path.resolve())]
        command += ["-update", "1", "-c:v", "png", "-f", "image2pipe", "-"]
        made = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=20, check=True).stdout
    except (OSError, RuntimeError, subprocess.SubprocessError):
        return None
    _, signature, frame = made.rpartition(b"\x89PNG\r\n\x1a\n")
    return signature + frame if signature else None


def _still(image: bytes) -> str | None:
    """A PNG as small JPEG in a data URI, or None if it cannot be read."""
    from PIL import Image

    out = io.BytesIO()
    try:
        with Image.open(io.BytesIO(image)) as picture:
            small = picture.convert("RGB")
        small.thumbnail((POSTER_SIZE, POSTER_SIZE))
        small.save(out, "JPEG", quality=88)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        return None
    return _data_uri("image/jpeg", out.getvalue())


def _data_uri(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
