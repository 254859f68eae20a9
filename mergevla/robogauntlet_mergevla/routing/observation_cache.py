"""First observations of a task in a file, so that routers can be evaluated again without a simulator."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robogauntlet.adapters.catalog import body_of
from robogauntlet.adapters.contract import FloatArray, Observation
from robogauntlet.suites.episode import RenderProfile, View, content_hash
from robogauntlet.support.errors import first_line
from robogauntlet.support.files import replacing
from robogauntlet_mergevla.routing.contract import FirstObservation, RoutingError

UNREADABLE = (OSError, EOFError, KeyError, TypeError, ValueError, AttributeError, zipfile.BadZipFile, zlib.error)


@dataclass(frozen=True, eq=False)
class ObservationCache:
    """The first observation of each of several episodes of one task, under the clean condition."""

    task: str
    """`simulator/task`."""
    view: View
    seeds: tuple[int, ...]
    """Seeds of the n episodes."""
    images: NDArray[np.uint8]
    """Shape (n, cameras, H, W, 3)."""
    proprioception: FloatArray
    """Shape (n, numbers), in the units of `robogauntlet.adapters.contract`."""
    instructions: tuple[str, ...]
    """Instruction of each episode."""

    def __post_init__(self) -> None:
        count, size = len(self.seeds), self.view.image_size
        images = (count, len(self.view.cameras), size, size, 3)
        if self.images.shape != images or self.images.dtype != np.uint8:
            given = f"{self.images.shape} of {self.images.dtype}"
            raise RoutingError(f"{self.task}: expected images of shape {images} of uint8, got {given}")
        numbers = body_of(self.task).proprioception_dim
        if self.proprioception.shape != (count, numbers) or len(self.instructions) != count:
            given = f"{self.proprioception.shape} and {len(self.instructions)} instructions"
            raise RoutingError(
                f"{self.task}: expected proprioception and an instruction of {count} episodes, got {given}"
            )

    @classmethod
    def of(cls, task: str, view: View, seeds: Sequence[int], observations: Sequence[Observation]) -> ObservationCache:
        """Build the cache from one observation per seed."""
        return cls(
            task,
            view,
            tuple(seeds),
            np.stack([[seen.images[camera] for camera in view.cameras] for seen in observations]),
            np.stack([seen.proprioception for seen in observations]).astype(np.float64),
            tuple(seen.instruction for seen in observations),
        )

    def covers(self, view: View, seeds: Sequence[int]) -> bool:
        """Whether the cache holds all these seeds under this view."""
        return self.view == view and set(seeds) <= set(self.seeds)

    def observations(self, seeds: Sequence[int]) -> list[FirstObservation]:
        """Return the first observations of these seeds, in order. The same on every machine, episode ids included."""
        import torch  # not needed by the processes of simulators, which save observations

        return [
            FirstObservation(
                images=torch.from_numpy(self.images[index]).permute(0, 3, 1, 2).float() / 255.0,
                instruction=self.instructions[index],
                proprioception=self.proprioception[index],
                episode_id=content_hash({"first look": self.task, "seed": seed}),
                task=self.task,
            )
            for index, seed in ((self.seeds.index(seed), seed) for seed in seeds)
        ]


def file_of(folder: Path, task: str) -> Path:
    """Return the path of a task's file in a folder: `pybullet__PandaPush-v3.npz`."""
    return folder / f"{task.replace('/', '__')}.npz"


def save_observations(cache: ObservationCache, path: Path) -> None:
    """Write the file, replacing an older one once the new one is complete."""
    with replacing(path) as partial, partial.open("wb") as file:
        np.savez_compressed(
            file,
            task=np.array(cache.task),
            cameras=np.array(cache.view.cameras),
            image_size=np.array(cache.view.image_size),
            render_profile=np.array(str(cache.view.render_profile)),
            seeds=np.array(cache.seeds, dtype=np.int64),
            images=cache.images,
            proprioception=cache.proprioception,
            instructions=np.array(cache.instructions),
        )


def load_observations(path: Path) -> ObservationCache:
    """Read what `save_observations` wrote. Raises RoutingError for a file of another format, pickles included."""
    try:
        with np.load(path, allow_pickle=False) as arrays:
            cameras, size = tuple(map(str, arrays["cameras"])), int(arrays["image_size"])
            return ObservationCache(
                str(arrays["task"]),
                View(cameras, size, RenderProfile(str(arrays["render_profile"]))),
                tuple(map(int, arrays["seeds"])),
                arrays["images"],
                arrays["proprioception"].astype(np.float64),
                tuple(map(str, arrays["instructions"])),
            )
    except UNREADABLE as error:
        raise RoutingError(f"{path}: expected first observations of a task, got {first_line(error)}") from None
    except RoutingError as error:
        raise RoutingError(f"{path}: {error}") from None
