"""Open-loop replay: the actions of one demonstration of the task, without any observation.

A task or a perturbation that it solves does not measure perception. The demonstrations are the oracles' on a training
seed, without noise (`scripts/replays.py` records them), or the first episodes of given datasets.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import ACTION_DIM, FloatArray
from robogauntlet.policies.contract import (
    Decision,
    Policy,
    PolicyError,
    PolicyFiles,
    PolicyInput,
    PolicyKind,
    PolicySpec,
    Query,
    StatelessPolicy,
)
from robogauntlet.policies.digests import source_digest
from robogauntlet.suites.episode import Episode, content_hash
from robogauntlet.suites.plugins import did_you_mean

FILE = Path(__file__).with_name("open_loop_replays.json")
CHUNK_LENGTH = 8


@cache
def replays() -> Mapping[str, FloatArray]:
    """Return each task's (`simulator/task`) recorded actions, shape (steps, 7).

    Raises:
        PolicyError: The file is missing or malformed.
    """
    try:
        document = json.loads(FILE.read_text(encoding="utf-8"))
        found = {task: np.array(entry["actions"], dtype=np.float64) for task, entry in document.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise PolicyError(
            f"{FILE.name}: expected a demonstration per task, got {type(error).__name__}: {error}"
        ) from None
    for task, actions in found.items():
        if actions.ndim != 2 or actions.shape[1] != ACTION_DIM or not np.isfinite(actions).all():
            raise PolicyError(f"{FILE.name}: expected actions of shape (n, {ACTION_DIM}) for {task}")
    return found


def demonstrated(folder: Path) -> Mapping[str, FloatArray]:
    """Return the actions of the first episode of each dataset, task to shape (steps, 7).

    Args:
        folder: Folder of datasets, or of one.

    Raises:
        PolicyError: There is none, one cannot be read or has a seed that suites play, two are of one task, or the
            actions of one are not those that were executed from the task's start.
    """
    from robogauntlet.policies.training.dataset import open_datasets
    from robogauntlet.policies.training.lerobot_format import DatasetError

    try:
        datasets = open_datasets([folder])
        for dataset in datasets:
            if not dataset.is_replayable:
                raise DatasetError(
                    f"{dataset.folder}: expected episodes without noise and without a learner, since the actions "
                    "of others are not all that was executed; record it by --noise 0"
                )
    except DatasetError as error:
        raise PolicyError(f"policy 'replay': {error}") from None
    found = {dataset.task: dataset.actions[: dataset.ends[0]].astype(np.float64) for dataset in datasets}
    if len(found) < len(datasets):
        raise PolicyError(f"policy 'replay': {folder}: expected one dataset per task, got several of one task")
    return found


class ReplayPolicy(StatelessPolicy):
    """Plays each task's demonstration from its first step, then stands still without moving the gripper."""

    def __init__(self, actions: Mapping[str, FloatArray]) -> None:
        """Take each task's actions, shape (steps, 7)."""
        self._actions = actions
        self.spec = PolicySpec(PolicyInput.NOTHING, CHUNK_LENGTH, tasks=frozenset(actions))

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Refuse episodes of a task without a demonstration."""
        for episode in episodes:
            if episode.task not in self._actions:
                known = did_you_mean(episode.task, self._actions)
                raise PolicyError(f"expected a task with a recorded demonstration, got '{episode.task}'{known}")

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return the demonstration's next actions."""
        return [Decision(_after(self._actions[query.episode.task], query.step)) for query in queries]


def _after(actions: FloatArray, step: int) -> FloatArray:
    """The chunk (CHUNK_LENGTH, 7) from a step on."""
    chunk = np.zeros((CHUNK_LENGTH, ACTION_DIM))
    chunk[:, -1] = actions[-1, -1]
    rest = actions[step : step + CHUNK_LENGTH]
    chunk[: len(rest)] = rest
    return chunk


def _folder(options: Mapping[str, Any]) -> Path | None:
    folder = options.get("demonstrations")
    if folder is None:
        return None
    if not isinstance(folder, str) or not folder:
        raise PolicyError(f"policy 'replay': expected option demonstrations: a folder of datasets, got {folder!r}")
    return Path(folder)


def _actions(options: Mapping[str, Any]) -> Mapping[str, FloatArray]:
    folder = _folder(options)
    return replays() if folder is None else demonstrated(folder)


def _load(options: Mapping[str, Any]) -> Policy:
    return ReplayPolicy(_actions(options))


def _digest(options: Mapping[str, Any]) -> str:
    actions = {task: np.round(values, 6).tolist() for task, values in _actions(options).items()}
    return content_hash({"policy": "replay", "source": source_digest(sys.modules[__name__]), "actions": actions})


def _files(options: Mapping[str, Any]) -> PolicyFiles:
    folder = _folder(options)
    if folder is None:
        return PolicyFiles({}, ())
    found = tuple(sorted(path for path in folder.resolve().rglob("*") if path.is_file()))
    return PolicyFiles({"demonstrations": folder.resolve()}, found)


REPLAY = PolicyKind(
    name="replay",
    summary="one demonstration's actions, open loop",
    load=_load,
    digest=_digest,
    options={"demonstrations": "folder of datasets, whose first episodes are played; by default the recorded ones"},
    files=_files,
    no_skill=True,
)
