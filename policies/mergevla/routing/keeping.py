"""First observations of a task, kept in a file, so that routers can be judged again without a simulator."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from adapters.contract import PROPRIOCEPTION_DIM, FloatArray, Observation
from policies.mergevla.routing.contract import RoutingError, Sighting
from suites.vocabulary import RenderProfile, View, content_hash

SUFFIX = ".npz"
UNREADABLE = (OSError, EOFError, KeyError, TypeError, ValueError, AttributeError, zipfile.BadZipFile, zlib.error)


@dataclass(frozen=True, eq=False)
class FirstLooks:
    """The first observation of each of several episodes of one task, under the clean condition."""

    task: str
    """`simulator/task`."""
    view: View
    """What was rendered."""
    seeds: tuple[int, ...]
    """Of the n episodes."""
    images: NDArray[np.uint8]
    """Shape (n, cameras, H, W, 3)."""
    proprioception: FloatArray
    """Shape (n, 8), in the units of `adapters.contract`."""
    instructions: tuple[str, ...]
    """As each episode gave it."""

    def __post_init__(self) -> None:
        count, size = len(self.seeds), self.view.image_size
        images = (count, len(self.view.cameras), size, size, 3)
        if self.images.shape != images or self.images.dtype != np.uint8:
            came = f"{self.images.shape} of {self.images.dtype}"
            raise RoutingError(f"{self.task}: expected images of shape {images} of uint8, got {came}")
        if self.proprioception.shape != (count, PROPRIOCEPTION_DIM) or len(self.instructions) != count:
            came = f"{self.proprioception.shape} and {len(self.instructions)} instructions"
            raise RoutingError(
                f"{self.task}: expected proprioception and an instruction of {count} episodes, got {came}"
            )

    @classmethod
    def of(cls, task: str, view: View, seeds: Sequence[int], observations: Sequence[Observation]) -> FirstLooks:
        """Those observations, one per seed."""
        return cls(
            task,
            view,
            tuple(seeds),
            np.stack([[seen.images[camera] for camera in view.cameras] for seen in observations]),
            np.stack([seen.proprioception for seen in observations]).astype(np.float64),
            tuple(seen.instruction for seen in observations),
        )

    def covers(self, view: View, seeds: Sequence[int]) -> bool:
        """Whether these seeds under this view are among them."""
        return self.view == view and set(seeds) <= set(self.seeds)

    def sightings(self, seeds: Sequence[int]) -> list[Sighting]:
        """What a router is given of these seeds, in order. Equal on every machine, the episode's id included."""
        place = {seed: index for index, seed in enumerate(self.seeds)}
        return [self._sighting(place[seed]) for seed in seeds]

    def _sighting(self, index: int) -> Sighting:
        return Sighting(
            images=torch.from_numpy(self.images[index]).permute(0, 3, 1, 2).float() / 255.0,
            instruction=self.instructions[index],
            proprioception=self.proprioception[index],
            episode_id=content_hash({"first look": self.task, "seed": self.seeds[index]}),
            task=self.task,
        )


def file_of(folder: Path, task: str) -> Path:
    """Where a folder keeps a task: `pybullet__PandaPush-v3.npz`."""
    return folder / f"{task.replace('/', '__')}{SUFFIX}"


def save_looks(looks: FirstLooks, path: Path) -> None:
    """Write them; what was there is replaced once they are written whole."""
    partial = path.with_name(f".{path.name}.partial{SUFFIX}")
    np.savez_compressed(
        partial,
        task=np.array(looks.task),
        cameras=np.array(looks.view.cameras),
        image_size=np.array(looks.view.image_size),
        render_profile=np.array(str(looks.view.render_profile)),
        seeds=np.array(looks.seeds, dtype=np.int64),
        images=looks.images,
        proprioception=looks.proprioception,
        instructions=np.array(looks.instructions),
    )
    partial.replace(path)


def load_looks(path: Path) -> FirstLooks:
    """What `save_looks` wrote. Pickled objects are refused.

    Raises:
        RoutingError: The file is something else.
    """
    try:
        with np.load(path, allow_pickle=False) as found:
            return _looks(found)
    except UNREADABLE as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RoutingError(f"{path}: expected first observations of a task, got {said}") from None
    except RoutingError as error:
        raise RoutingError(f"{path}: {error}") from None


def _looks(found: Any) -> FirstLooks:
    view = View(
        tuple(map(str, found["cameras"])), int(found["image_size"]), RenderProfile(str(found["render_profile"]))
    )
    return FirstLooks(
        str(found["task"]),
        view,
        tuple(map(int, found["seeds"])),
        found["images"],
        found["proprioception"].astype(np.float64),
        tuple(map(str, found["instructions"])),
    )
