"""Selects images and videos of a run and encodes them as data URIs, so that the report is one file."""

from __future__ import annotations

import base64
import contextlib
import io
import subprocess
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robogauntlet.results.media_paths import SHARED_BY, is_own_file, picture_path, snapshot_path, videos_folder
from robogauntlet.results.record import Status, outcome_text
from robogauntlet.results.report.parquet import read_frame
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.store.episodes_parquet import EPISODES_FILE
from robogauntlet.suites.episode import CLEAN, CONTROLS, Condition
from robogauntlet.support.files import read_regular

if TYPE_CHECKING:
    import pandas as pd

LARGEST_VIDEO = 1_000_000_000
"""Bytes."""
VIDEO_BUDGET = 9_000_000
"""Maximum size of the videos in one report, before base64 encoding (bytes)."""
POSTER_SIZE = 256
"""Maximum width and height of a still image (px)."""


@dataclass(frozen=True, slots=True)
class Video:
    """The video of an episode."""

    episode_id: str
    policy: str
    policy_digest: str
    task: str
    status: str
    seed: int
    condition: Condition
    path: Path
    size: int
    """Size of the file (bytes)."""
    source: str | None = None
    """Data URI, or None if left out because of its size."""
    poster: str | None = None
    """Data URI of the last frame."""
    same_as: Video | None = None
    """The video of another policy that acted identically, which the report shows in place of this one."""
    failure: str | None = None
    """Kind of the failure, as the row has it."""

    @property
    def simulator(self) -> str:
        """Simulator of the task."""
        return self.task.partition("/")[0]

    @property
    def outcome(self) -> str:
        """The status for captions, with the kind of a failure if it is known."""
        return outcome_text(self.status, self.failure)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The first observation under a condition, cameras side by side."""

    condition: Condition
    source: str
    """Data URI."""


@dataclass(frozen=True, slots=True)
class Strip:
    """Snapshots of one task: clean, then one per severity of an axis."""

    task: str
    snapshots: tuple[Snapshot, ...]


@dataclass(frozen=True, slots=True)
class Media:
    """The images and videos of a report."""

    representative: tuple[Video, ...] = ()
    """Per policy and task the first success and failure, in order of condition (clean first) and seed."""
    new_failures: tuple[Video, ...] = ()
    """Per axis, simulator and policy the mildest recorded failure whose clean episode succeeded."""
    strips: Mapping[str, tuple[Strip, ...]] = field(default_factory=dict)
    """Axis to its strips; axes without a visible effect on the first observation are left out."""

    @property
    def left_out(self) -> int:
        """Number of videos that are not embedded."""
        videos = (*self.representative, *self.new_failures)
        return len({video.episode_id for video in videos if video.source is None and video.same_as is None})


def collect_media(folder: Path, document: RunDocument, frame: pd.DataFrame, budget: int = VIDEO_BUDGET) -> Media:
    """Collect the images and videos in a run folder.

    Rows need the columns `episode_id`, `policy_digest`, `task`, `axis`, `severity`, `seed` and `status`; the folder has
    `episodes.parquet`. If the videos exceed `budget` bytes, representative videos have priority, then smaller files.
    """
    names = {cell.policy_digest: cell.policy for cell in document.plan}
    files = {path.stem: path for path in sorted(videos_folder(folder).glob("*.mp4")) if is_own_file(folder, path)}
    recorded = _with_video(folder, frame, files)
    recorded = recorded.loc[recorded["status"].astype(str).isin([Status.SUCCESS, Status.FAILURE])]
    recorded = recorded.assign(perturbed=recorded["axis"].astype(str) != CLEAN)
    recorded = recorded.sort_values(["perturbed", "severity", "axis", "seed", "task"], kind="stable")
    excluded = {cell.policy_digest for cell in document.plan if cell.policy in document.suite.reference_policies}

    def videos(chosen: pd.DataFrame) -> list[Video]:
        found = [_video(row, names, files) for row in chosen.itertuples(index=False)]
        return sorted((video for video in found if video.size), key=lambda video: order[video.policy])

    order = {name: place for place, name in enumerate(dict.fromkeys(names.values()))}
    first: dict[Path, Video] = {}
    representative, left = _embed(videos(recorded.drop_duplicates(["policy_digest", "task", "status"])), budget, first)
    new_failures, _ = _embed(videos(_new_failures(recorded, frame, excluded)), left, first)
    return Media(representative, new_failures, _strips(folder, document))


def _with_video(folder: Path, frame: pd.DataFrame, recorded: Collection[str]) -> pd.DataFrame:
    """The rows that the videos of these episodes show, with the id of the recorded episode as `video`."""
    path, columns = folder / EPISODES_FILE, ("episode_id", *SHARED_BY)
    videos = read_frame(path, columns, where=("episode_id", recorded)).drop_duplicates(SHARED_BY)
    rows = read_frame(path, (*columns, "failure"), where=("pair_id", videos["pair_id"]))
    shown = rows.merge(videos.rename(columns={"episode_id": "video"}), on=list(SHARED_BY))
    return frame.merge(shown[["episode_id", "video", "failure"]], on="episode_id")


def _new_failures(recorded: pd.DataFrame, frame: pd.DataFrame, excluded: Collection[str]) -> pd.DataFrame:
    pair = ["policy_digest", "task", "seed"]
    clean_successes = frame.loc[
        (frame["axis"].astype(str) == CLEAN) & (frame["status"].astype(str) == Status.SUCCESS), pair
    ]
    failures = recorded.loc[
        (recorded["status"].astype(str) == Status.FAILURE) & ~recorded["axis"].isin([CLEAN, *CONTROLS])
    ]
    failures = failures.loc[~failures["policy_digest"].isin(list(excluded))]
    both = failures.merge(clean_successes.drop_duplicates(), on=pair)
    simulator = both["task"].astype(str).str.split("/").str[0]
    return both.loc[~both.assign(simulator=simulator).duplicated(["axis", "simulator", "policy_digest"])]


def _strips(folder: Path, document: RunDocument) -> dict[str, tuple[Strip, ...]]:
    planned: dict[str, dict[str, set[int]]] = {}
    for cell in document.plan:
        if cell.condition.is_on_scale:
            planned.setdefault(cell.axis, {}).setdefault(cell.task, set()).add(cell.severity)
    strips = {}
    for axis, tasks in planned.items():
        stored = (_strip(folder, task, axis, sorted(severities)) for task, severities in tasks.items())
        strips[axis] = tuple(strip for strip in stored if strip is not None)
    return {axis: own for axis, own in strips.items() if own}


def _strip(folder: Path, task: str, axis: str, severities: Sequence[int]) -> Strip | None:
    """The stored snapshots; None if none differs from the clean one."""
    files = {}
    for condition in (Condition(), *(Condition(axis, severity) for severity in severities)):
        with contextlib.suppress(OSError):
            files[condition] = _read_picture(folder, snapshot_path(folder, task, condition))
    if Condition() not in files or len(set(files.values())) < 2:
        return None
    snapshots = (Snapshot(condition, source) for condition, file in files.items() if (source := _still(file)))
    return Strip(task, tuple(snapshots))


def _read_picture(folder: Path, path: Path) -> bytes:
    """The content of a picture of the run. Raises OSError."""
    if not is_own_file(folder, path):
        raise FileNotFoundError(path)
    return read_regular(path)


def task_picture(folder: Path, task: str) -> str | None:
    """Return the image of a task as data URI, or None if it cannot be read."""
    try:
        return _still(_read_picture(folder, picture_path(folder, task)))
    except OSError:
        return None


def _video(row: Any, names: Mapping[str, str], files: Mapping[str, Path]) -> Video:
    path = files[row.video]
    return Video(
        episode_id=row.episode_id,
        policy=names[str(row.policy_digest)],
        policy_digest=str(row.policy_digest),
        task=str(row.task),
        status=str(row.status),
        seed=int(row.seed),
        condition=Condition(str(row.axis), int(row.severity)),
        path=path,
        size=path.stat().st_size,
        failure=row.failure,
    )


def _embed(videos: Sequence[Video], budget: int, first: dict[Path, Video]) -> tuple[tuple[Video, ...], int]:
    """Embed the smallest videos within the budget; return all videos and the remaining budget.

    The file that several policies share is embedded with the first of them, which `first` has or gets.
    """
    for video in videos:
        first.setdefault(video.path, video)
    own = [video for video in videos if first[video.path].episode_id == video.episode_id]
    fitting: set[str] = set()
    for video in sorted(own, key=lambda video: (video.size, video.episode_id)):
        if video.size > budget:
            break
        budget -= video.size
        fitting.add(video.episode_id)
    embedded = []
    for video in videos:
        if first[video.path].episode_id != video.episode_id:
            video = replace(video, same_as=first[video.path])
        elif video.episode_id in fitting:
            frame, source = last_frame(video.path), _data_uri("video/mp4", read_regular(video.path, LARGEST_VIDEO))
            video = replace(video, source=source, poster=None if frame is None else _still(frame))
        embedded.append(video)
    return tuple(embedded), budget


def last_frame(path: Path) -> bytes | None:
    """Return the last frame of a video as PNG, or None if it cannot be decoded."""
    import imageio_ffmpeg

    try:
        ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
        # Decodes the last half second and lets each frame overwrite the one before it. With -f, nothing in the file
        # can make it a list of other files.
        command = [ffmpeg, "-v", "error", "-f", "mp4", "-sseof", "-0.5", "-i", str(path.resolve())]
        command += ["-update", "1", "-c:v", "png", "-f", "image2pipe", "-"]
        output = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=20, check=True).stdout
    except (OSError, RuntimeError, subprocess.SubprocessError):
        return None
    _, signature, frame = output.rpartition(b"\x89PNG\r\n\x1a\n")
    return signature + frame if signature else None


def _still(image: bytes) -> str | None:
    """Return a PNG as small JPEG data URI, or None if it cannot be read."""
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
