"""Pictures and videos of a run, chosen, and made into data URIs so that the report is one file."""

from __future__ import annotations

import base64
import contextlib
import io
import subprocess
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from results.media import look_path, picture_path, videos_folder
from results.record import Status
from results.run import RunDocument
from suites.vocabulary import CLEAN, CONTROLS, Condition

if TYPE_CHECKING:
    import pandas as pd

VIDEO_BUDGET = 9_000_000
"""Bytes of video in one report, which holds them as text that is a third longer."""
POSTER_SIZE = 256
"""Greatest width and height of a still (px)."""


@dataclass(frozen=True, slots=True)
class Video:
    """A recorded episode that stands for a policy's successes or failures, on a task or along an axis."""

    episode_id: str
    policy: str
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


@dataclass(frozen=True, slots=True)
class Look:
    """What policies see first under a condition, cameras side by side."""

    condition: Condition
    source: str
    """Data URI."""


@dataclass(frozen=True, slots=True)
class Strip:
    """Looks at one task: the clean one, then one for each severity of an axis."""

    task: str
    looks: tuple[Look, ...]


@dataclass(frozen=True, slots=True)
class Media:
    """What a report shows beside its numbers."""

    typical: tuple[Video, ...] = ()
    """Per policy and task the first success and the first failure: clean ones first, then by seed."""
    fallen: tuple[Video, ...] = ()
    """Per axis, simulator and policy a failure whose clean episode succeeded: the mildest, by seed."""
    strips: Mapping[str, tuple[Strip, ...]] = field(default_factory=dict)
    """Axis to what it looks like; axes that show nothing in the first look are left out."""

    @property
    def left_out(self) -> int:
        """Videos that are not embedded."""
        return len({video.episode_id for video in (*self.typical, *self.fallen) if video.source is None})


def collect_media(folder: Path, document: RunDocument, frame: pd.DataFrame, budget: int = VIDEO_BUDGET) -> Media:
    """What was filmed and pictured of a run.

    Args:
        folder: The run folder.
        document: The run.
        frame: Rows with the columns `episode_id`, `policy_digest`, `task`, `axis`, `severity`, `seed` and `status`.
        budget: Bytes to embed. If the files are larger together, typical ones come first, of each kind the smallest.
    """
    names = {cell.policy_digest: cell.policy for cell in document.plan}
    files = {path.stem: path for path in sorted(videos_folder(folder).glob("*.mp4")) if path.is_file()}
    filmed = frame.loc[frame["episode_id"].isin(list(files))]
    filmed = filmed.loc[filmed["status"].astype(str).isin([Status.SUCCESS, Status.FAILURE])]
    filmed = filmed.assign(perturbed=filmed["axis"].astype(str) != CLEAN)
    filmed = filmed.sort_values(["perturbed", "severity", "axis", "seed", "task"], kind="stable")
    aside = {cell.policy_digest for cell in document.plan if cell.policy in (document.gate, *document.floors)}

    def videos(chosen: pd.DataFrame) -> list[Video]:
        found = [_video(row, names, files) for row in chosen.itertuples(index=False)]
        return [video for video in found if video.size]

    typical, left = _embed(videos(_typical(filmed)), budget)
    fallen, _ = _embed(videos(_fallen(filmed, frame, aside)), left)
    return Media(typical, fallen, _strips(folder, document))


def _typical(filmed: pd.DataFrame) -> pd.DataFrame:
    return filmed.drop_duplicates(["policy_digest", "task", "status"])


def _fallen(filmed: pd.DataFrame, frame: pd.DataFrame, aside: Collection[str]) -> pd.DataFrame:
    pair = ["policy_digest", "task", "seed"]
    stood = frame.loc[(frame["axis"].astype(str) == CLEAN) & (frame["status"].astype(str) == Status.SUCCESS), pair]
    failures = filmed.loc[(filmed["status"].astype(str) == Status.FAILURE) & ~filmed["axis"].isin([CLEAN, *CONTROLS])]
    failures = failures.loc[~failures["policy_digest"].isin(list(aside))]
    both = failures.merge(stood.drop_duplicates(), on=pair)
    simulator = both["task"].astype(str).str.split("/").str[0]
    return both.loc[~both.assign(simulator=simulator).duplicated(["axis", "simulator", "policy_digest"])]


def _strips(folder: Path, document: RunDocument) -> dict[str, tuple[Strip, ...]]:
    planned: dict[str, dict[str, dict[int, None]]] = {}
    for cell in document.plan:
        if cell.axis not in (CLEAN, *CONTROLS):
            planned.setdefault(cell.axis, {}).setdefault(cell.task, {})[cell.severity] = None
    strips = {
        axis: tuple(_strip(folder, task, axis, sorted(own)) for task, own in tasks.items())
        for axis, tasks in planned.items()
    }
    seen = {axis: tuple(strip for strip in own if strip is not None) for axis, own in strips.items()}
    return {axis: own for axis, own in seen.items() if own}


def _strip(folder: Path, task: str, axis: str, severities: Sequence[int]) -> Strip | None:
    """The looks that were kept; None if there are none, or none that differs from the clean one."""
    files = {}
    for condition in (Condition(), *(Condition(axis, severity) for severity in severities)):
        with contextlib.suppress(OSError):
            files[condition] = look_path(folder, task, condition).read_bytes()
    if Condition() not in files or len(set(files.values())) < 2:
        return None
    looks = (Look(condition, source) for condition, file in files.items() if (source := _still(file)))
    return Strip(task, tuple(looks))


def task_picture(folder: Path, task: str) -> str | None:
    """Data URI of a task's picture, or None if there is none that can be read."""
    try:
        return _still(picture_path(folder, task).read_bytes())
    except OSError:
        return None


def _video(row: object, names: Mapping[str, str], files: Mapping[str, Path]) -> Video:
    value = row.__getattribute__
    path = files[value("episode_id")]
    return Video(
        episode_id=value("episode_id"),
        policy=names[str(value("policy_digest"))],
        policy_digest=str(value("policy_digest")),
        task=str(value("task")),
        status=str(value("status")),
        seed=int(value("seed")),
        condition=Condition(str(value("axis")), int(value("severity"))),
        path=path,
        size=path.stat().st_size,
    )


def _embed(videos: Sequence[Video], budget: int) -> tuple[tuple[Video, ...], int]:
    """The videos, the smallest of them embedded as far as the budget goes, and what is left of it."""
    fitting: set[str] = set()
    for video in sorted(videos, key=lambda video: (video.size, video.episode_id)):
        if video.size > budget:
            break
        budget -= video.size
        fitting.add(video.episode_id)
    return tuple(_embedded(video) if video.episode_id in fitting else video for video in videos), budget


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
