"""Open-loop replay: the actions of one demonstration of the task, without any observation.

A task or a perturbation that it solves does not measure perception. The demonstrations are the oracles' on a training
seed, without noise (`scripts/replays.py` records them), or the first of each task in given datasets.
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
def replays(demonstrations: str = "") -> Mapping[str, FloatArray]:
    """Return each task's (`simulator/task`) demonstrated actions, shape (steps, 7).

    Args:
        demonstrations: Folder of datasets, or of one; empty for the recorded ones.

    Raises:
        PolicyError: A file is missing or malformed, or a dataset has a seed that suites play.
    """
    if demonstrations:
        return _first_episodes(Path(demonstrations))
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


def _first_episodes(folder: Path) -> Mapping[str, FloatArray]:
    from robogauntlet.policies.training.dataset import open_datasets
    from robogauntlet.policies.training.lerobot_format import DatasetError

    try:
        datasets = open_datasets([folder])
    except DatasetError as error:
        raise PolicyError(f"policy 'replay': {error}") from None
    return {dataset.task: dataset.actions[: dataset.ends[0]].astype(np.float64) for dataset in datasets}


class ReplayPolicy(StatelessPolicy):
    """Plays each task's demonstration from its first step, then stands still without moving the gripper."""

    def __init__(self, demonstrations: str = "") -> None:
        """Take the demonstrations of `replays`, whose errors it raises."""
        self._replays = replays(demonstrations)
        self.spec = PolicySpec(PolicyInput.NOTHING, CHUNK_LENGTH, tasks=frozenset(self._replays))

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Refuse episodes of a task without a demonstration."""
        for episode in episodes:
            if episode.task not in self._replays:
                known = did_you_mean(episode.task, self._replays)
                raise PolicyError(f"expected a task with a recorded demonstration, got '{episode.task}'{known}")

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return the demonstration's next actions."""
        return [Decision(_after(self._replays[query.episode.task], query.step)) for query in queries]


def _after(actions: FloatArray, step: int) -> FloatArray:
    """The chunk (CHUNK_LENGTH, 7) from a step on."""
    chunk = np.zeros((CHUNK_LENGTH, ACTION_DIM))
    chunk[:, -1] = actions[-1, -1]
    rest = actions[step : step + CHUNK_LENGTH]
    chunk[: len(rest)] = rest
    return chunk


def _demonstrations(options: Mapping[str, Any]) -> str:
    folder = options.get("demonstrations", "")
    if not isinstance(folder, str):
        raise PolicyError(f"policy 'replay': expected option demonstrations: a folder of datasets, got {folder!r}")
    return folder


def _load(options: Mapping[str, Any]) -> Policy:
    return ReplayPolicy(_demonstrations(options))


def _digest(options: Mapping[str, Any]) -> str:
    found = replays(_demonstrations(options))
    actions = {task: np.round(values, 6).tolist() for task, values in found.items()}
    return content_hash({"policy": "replay", "source": source_digest(sys.modules[__name__]), "actions": actions})


REPLAY = PolicyKind(
    name="replay",
    summary="one demonstration's actions, open loop",
    load=_load,
    digest=_digest,
    options={"demonstrations": "folder of datasets, whose first episodes are played; by default the recorded ones"},
)
