"""Videos of episodes, through ffmpeg."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adapters.contract import PICTURE_SIZE, Image, Simulation

MAX_FRAMES = 60


@dataclass(frozen=True)
class Made:
    """What came of filming an episode or taking a look."""

    files: tuple[Path, ...] = ()
    trouble: str | None = None
    """What is wrong with it, in a line."""


class Recorder:
    """A `rollout` watcher that writes an mp4 (H.264) of the third-person view, at most about `MAX_FRAMES` frames."""

    def __init__(self, path: Path, *, steps: int) -> None:
        """Args: path: of the video; steps: how long the episode is expected to be, in control steps."""
        self._path = path
        self._every = max(1, -(-steps // MAX_FRAMES))
        self._writer: Any = None
        self.first: Image | None = None
        """The picture after reset."""

    def __call__(self, simulation: Simulation, step: int) -> None:
        """Add a frame, if it is time for one."""
        if step % self._every:
            return
        frame = simulation.picture()
        if self.first is None:
            self.first = frame
        if self._writer is None:
            self._writer = self._open(simulation.action_spec.control_hz / self._every)
        self._writer.send(frame.tobytes())

    def _open(self, fps: float) -> Any:
        import imageio_ffmpeg

        self._path.parent.mkdir(parents=True, exist_ok=True)
        writer = imageio_ffmpeg.write_frames(
            str(self._path),
            (PICTURE_SIZE, PICTURE_SIZE),
            fps=fps,
            codec="libx264",
            pix_fmt_out="yuv420p",
            output_params=["-crf", "27", "-movflags", "+faststart"],
            macro_block_size=2,
            ffmpeg_log_level="error",
        )
        writer.send(None)
        return writer

    def close(self) -> None:
        """Finish the file."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()


def save_png(path: Path, image: Image) -> None:
    """Write an RGB image (h, w, 3) as PNG."""
    from PIL import Image as Pillow

    path.parent.mkdir(parents=True, exist_ok=True)
    Pillow.fromarray(image).save(path, optimize=True)
