"""Joins videos of episodes side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import ImageDraw

from robogauntlet.adapters.contract import Image
from robogauntlet.orchestrator.episodes.video_recorder import video_writer
from robogauntlet.orchestrator.replay.contact_sheet import PAPER, write_fitting

TITLE_HEIGHT = 28
"""Height of the line above each video (px)."""
FONT_SIZE = 15
"""Of a title that fits (px)."""


def join_videos(parts: Sequence[Path], titles: Sequence[str], path: Path) -> None:
    """Write one video of several of equal height and frame rate, each under its title.

    One that has ended shows its last frame.
    """
    videos = [_frames(part) for part in parts]
    heads = [_title(title, frames.shape[2]) for title, (frames, _) in zip(titles, videos, strict=True)]
    width = sum(head.shape[1] for head in heads)
    height = TITLE_HEIGHT + videos[0][0].shape[1]
    partial = path.with_name(f".{path.name}.partial.mp4")
    writer = video_writer(partial, (width, height), videos[0][1])
    try:
        for number in range(max(len(frames) for frames, _ in videos)):
            shown = [frames[min(number, len(frames) - 1)] for frames, _ in videos]
            columns = [np.concatenate([head, frame]) for head, frame in zip(heads, shown, strict=True)]
            writer.send(np.ascontiguousarray(np.concatenate(columns, axis=1)).tobytes())
        writer.close()
        partial.replace(path)
    finally:
        writer.close()
        partial.unlink(missing_ok=True)


def _frames(path: Path) -> tuple[NDArray[np.uint8], float]:
    """Frames (n, h, w, 3) of a video, and how many there are per second."""
    import imageio_ffmpeg

    reader = imageio_ffmpeg.read_frames(str(path))
    about = next(reader)
    width, height = about["size"]
    frames = [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]
    return np.stack(frames), float(about["fps"])


def _title(text: str, width: int) -> Image:
    """A line of text."""
    line = Pillow.new("RGB", (width, TITLE_HEIGHT), PAPER)
    write_fitting(ImageDraw.Draw(line), (4, 5), text, FONT_SIZE, width - 8)
    return np.asarray(line)
