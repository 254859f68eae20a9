"""Films chosen episodes of a finished run and pictures its conditions, a Ray task per simulator."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import ray
from ray.exceptions import RayError

from adapters import catalog
from orchestrator.choosing import Look, fallen, typical
from orchestrator.cluster import answer
from orchestrator.looking import picture
from orchestrator.replay import film
from orchestrator.runner import PolicySource
from orchestrator.worker_environment import worker_environment
from results.media import look_path, video_path
from results.record import EpisodeResult


@dataclass
class Shots:
    """What is to be filmed and pictured in one simulator."""

    films: list[EpisodeResult] = field(default_factory=list)
    looks: list[Look] = field(default_factory=list)


def to_shoot(
    folder: Path, rows: Callable[[], Iterable[EpisodeResult]], in_question: Sequence[str], looks: Sequence[Look]
) -> dict[str, Shots]:
    """What of a run is worth it and not in its folder yet, by simulator.

    Args:
        folder: Of the run.
        rows: Gives the run's rows anew at every call.
        in_question: Names of the policies whose failures along the axes are filmed.
        looks: Conditions to picture.
    """
    shots: dict[str, Shots] = {}
    for row in {row.episode_id: row for row in (*typical(rows()), *fallen(rows, in_question))}.values():
        if not video_path(folder, row.episode_id).exists():
            shots.setdefault(row.simulator, Shots()).films.append(row)
    for look in looks:
        if not look_path(folder, look.task, look.condition).exists():
            shots.setdefault(look.task.partition("/")[0], Shots()).looks.append(look)
    return shots


def film_run(folder: Path, shots: Mapping[str, Shots], sources: Mapping[str, PolicySource]) -> list[str]:
    """Film and picture, within the run folder, a process per simulator beside each other. Ray must be running.

    Args:
        folder: Of the run.
        shots: See `to_shoot`.
        sources: The run's policies.

    Returns:
        A line for each episode that came out differently than its row, for each look that could not be had, and for
        each simulator that failed.
    """
    task: Any = ray.remote(_shoot)
    pending = {
        name: task.options(
            num_cpus=1, max_retries=0, runtime_env={"env_vars": worker_environment(catalog.find(name))}
        ).remote(own, folder.absolute(), dict(sources))
        for name, own in shots.items()
    }
    troubles: list[str] = []
    for name, reference in pending.items():
        try:
            troubles += answer(reference)
        except RayError as error:
            troubles.append(f"{name} could not be filmed: {str(error).strip().splitlines()[-1]}")
    return troubles


def _shoot(shots: Shots, folder: Path, sources: Mapping[str, PolicySource]) -> list[str]:
    troubles = [f"no picture: {line}" for line in picture(shots.looks, folder)]
    rows = sorted(shots.films, key=lambda row: (row.task, row.policy))
    return troubles + [f"replay differs: {line}" for line in film(rows, folder, sources)]
