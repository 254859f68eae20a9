"""The checkpoints in the folder of a training: which are there, and which are written whole. Loads nothing."""

from __future__ import annotations

import re
import stat
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

from robogauntlet.support.errors import first_line
from robogauntlet.support.files import LARGEST_DOCUMENT, open_regular, read_regular
from robogauntlet.support.json_text import parse_json

STEP = re.compile(r"(?:step|checkpoint|ckpt)s?[-_=]?([0-9]{1,18})(?![0-9])", re.IGNORECASE)
NUMBER = re.compile(r"(?<![0-9])[0-9]{1,18}(?![0-9])")
CHECKPOINTS, PRETRAINED = "checkpoints", "pretrained_model"
"""LeRobot's folder of checkpoints, and that of the policy in each."""
UNFINISHED = (".", "tmp", "_tmp")
"""First characters of the folders that trainers rename when they are whole."""
State = tuple[tuple[str, int, int], ...]
"""The files of a folder: path, bytes, and time of the last change (ns)."""


@dataclass(frozen=True, order=True)
class Checkpoint:
    """A checkpoint of a training."""

    step: int
    name: str
    """Its folder in that of the training."""
    folder: Path
    """The folder that its policy reads."""


def training_folder(folder: Path) -> Path:
    """Return the folder that has the checkpoints: LeRobot's `checkpoints` in this one, or this one; absolute."""
    folder = folder.absolute()
    return below if (below := folder / CHECKPOINTS).is_dir() else folder


def step_of(name: str) -> int | None:
    """Return the step in the name of a checkpoint's folder: `checkpoint-500`, `000500`, `epoch=3-step=500`."""
    numbers = STEP.findall(name) or NUMBER.findall(name)
    return int(numbers[-1]) if numbers and not name.lower().startswith(UNFINISHED) else None


def find_checkpoints(folder: Path) -> list[Checkpoint]:
    """Return the checkpoints in a folder, the newest first; none if it cannot be read.

    They are its subfolders with a step in their names. Links, such as LeRobot's `last`, are none.
    """
    try:
        steps = {path: step_of(path.name) for path in folder.iterdir() if path.is_dir() and not path.is_symlink()}
    except OSError:
        return []
    found = [
        Checkpoint(step, path.name, inner if (inner := path / PRETRAINED).is_dir() else path)
        for path, step in steps.items()
        if step is not None
    ]
    return sorted(found, reverse=True)


def state_of(folder: Path) -> State:
    """Return the files of a folder; none if it is deleted meanwhile."""
    try:
        files = [(path, path.stat()) for path in sorted(folder.rglob("*"))]
    except OSError:
        return ()
    return tuple((str(path), one.st_size, one.st_mtime_ns) for path, one in files if stat.S_ISREG(one.st_mode))


def written_at(state: State) -> float:
    """Return when its newest file was changed (seconds since 1970)."""
    return max((changed for _, _, changed in state), default=0) / 1e9


def fault_of(folder: Path) -> str | None:
    """Return what of a checkpoint is not whole, or None: JSON can be read, and safetensors have their full length."""
    for path in sorted(folder.rglob("*")):
        try:
            if path.suffix == ".json" and path.stat().st_size <= LARGEST_DOCUMENT:
                parse_json(read_regular(path))
            elif path.suffix == ".safetensors":
                _check_length(path)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            return f"{path.name} cannot be read: {first_line(error)}"
    return None


def _check_length(path: Path) -> None:
    """Raise ValueError unless a safetensors file is as long as its header says."""
    size = path.stat().st_size
    with open_regular(path) as file:
        length = int.from_bytes(file.read(8), "little")
        header = parse_json(file.read(length)) if length <= LARGEST_DOCUMENT else {}
    ends = [entry["data_offsets"][1] for name, entry in header.items() if name != "__metadata__"]
    if size != (expected := 8 + length + max(ends, default=0)):
        raise ValueError(f"expected {expected:,} bytes, got {size:,}")


class ReadyCheckpoints:
    """Tells which checkpoints of a training are written whole, by looking at them repeatedly."""

    def __init__(
        self, folder: Path, settle_s: float, refuse: Callable[[str], None], now: Callable[[], float] = time.monotonic
    ) -> None:
        """Watch a folder, see `training_folder`.

        Args:
            folder: The folder of the training.
            settle_s: Time for which the files of a checkpoint stay unchanged before it counts as whole (s).
            refuse: Receives a line about each checkpoint that is not whole although it does not change.
            now: The clock (s).
        """
        self.folder, self._settle_s, self._refuse, self._now = folder, settle_s, refuse, now
        self._seen: dict[str, tuple[State, float]] = {}
        self._refused: dict[str, State] = {}
        self.changed_at = now()
        """When a file of a checkpoint was last seen to change, by the clock."""

    def look(self, done: Collection[str] = ()) -> list[Checkpoint]:
        """Return those that are whole and neither `done` nor refused in this state, the newest first."""
        ready = []
        for one in find_checkpoints(training_folder(self.folder)):
            if one.name in done:
                continue
            state, now = state_of(one.folder), self._now()
            before, since = self._seen.get(one.name, (None, now))
            if state != before:
                self.changed_at = since = now
            self._seen[one.name] = state, since
            if state and now - since >= self._settle_s and self._refused.get(one.name) != state:
                if (fault := fault_of(one.folder)) is None:
                    ready.append(one)
                else:
                    self.refuse(one, f"not whole: {fault}")
        return ready

    def refuse(self, one: Checkpoint, why: str) -> None:
        """Report why a checkpoint is not played; it is not ready again until its files change."""
        self._refused[one.name] = self._seen[one.name][0]
        self._refuse(f"{one.name}: {why}" if one.folder.is_dir() else f"{one.name}: deleted; {why}")
