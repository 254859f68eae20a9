"""Videos of episodes, through ffmpeg."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from robogauntlet.adapters.contract import PICTURE_SIZE, Image, Simulation

MAX_FRAMES = 60
FRAMES_PER_S = 10.0


class VideoRecorder:
    """A `rollout` watcher that writes an mp4 (H.264) of the third-person view.

    It has about `FRAMES_PER_S`, and at most about `MAX_FRAMES`: drawing them costs more than all else in a replay.
    """

    def __init__(self, path: Path, *, steps: int) -> None:
        """Prepare a video of about this many control steps, which appears after a `with` block without exception."""
        self._path = path
        self._partial = path.with_name(f".{path.name}.partial.mp4")
        self._every = max(1, -(-steps // MAX_FRAMES))
        """Control steps from one frame to the next."""
        self._writer: Any = None
        self.first: Image | None = None
        """The frame after reset."""

    def __call__(self, simulation: Simulation, step: int) -> None:
        """Add a frame if one is due after this control step."""
        if self._writer is None:
            self._every = max(self._every, round(simulation.action_spec.control_hz / FRAMES_PER_S))
        if step % self._every:
            return
        frame = simulation.picture()
        if self.first is None:
            self.first = frame
        if self._writer is None:
            self._writer = self._open(simulation.action_spec.control_hz / self._every)
        self._writer.send(frame.tobytes())

    def _open(self, fps: float) -> Any:
        return video_writer(self._partial, (PICTURE_SIZE, PICTURE_SIZE), fps)

    def __enter__(self) -> VideoRecorder:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if self._writer is not None:
            self._writer.close()
            if kind is None:
                self._partial.replace(self._path)


def video_writer(path: Path, size: tuple[int, int], fps: float) -> Any:
    """A generator that writes the frames sent to it, RGB of this width and height as bytes, until it is closed."""
    import imageio_ffmpeg

    path.unlink(missing_ok=True)  # it may be a link that somebody put there
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = imageio_ffmpeg.write_frames(
        str(path),
        size,
        fps=fps,
        codec="libx264",
        pix_fmt_out="yuv420p",
        output_params=["-crf", "27", "-movflags", "+faststart"],
        macro_block_size=2,
        ffmpeg_log_level="error",
    )
    writer.send(None)
    return writer


def encode_png(image: Image) -> bytes:
    """An RGB image (h, w, 3) as PNG."""
    from PIL import Image as Pillow

    buffer = io.BytesIO()
    Pillow.fromarray(image).save(buffer, "png", optimize=True)
    return buffer.getvalue()
