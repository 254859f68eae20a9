"""Films chosen episodes of a finished run and pictures its conditions, a Ray task per simulator."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import ray
from ray.exceptions import RayError

from adapters import catalog
from orchestrator.choosing import Look, fallen, typical
from orchestrator.looking import picture
from orchestrator.replay import film
from orchestrator.runner import PolicySource
from orchestrator.worker_environment import worker_environment
from results.record import EpisodeResult


def film_run(
    folder: Path,
    rows: Callable[[], Iterable[EpisodeResult]],
    sources: Mapping[str, PolicySource],
    in_question: Sequence[str],
    looks: Sequence[Look],
) -> list[str]:
    """Film, within the run folder, a success and a failure of each policy on each task, and a failure along each axis.

    Args:
        folder: Of the run.
        rows: Gives the run's rows anew at every call.
        sources: The run's policies.
        in_question: Names of the policies whose failures along the axes are filmed.
        looks: Conditions to picture.

    Returns:
        A line for each episode that came out differently than its row, for each look that could not be had, and for
        each simulator that failed.
    """
    chosen = {row.episode_id: row for row in (*typical(rows()), *fallen(rows, in_question))}
    films: dict[str, list[EpisodeResult]] = {}
    for row in chosen.values():
        films.setdefault(row.simulator, []).append(row)
    pictures: dict[str, list[Look]] = {name: [] for name in films}
    for look in looks:
        pictures.setdefault(look.task.partition("/")[0], []).append(look)
    task: Any = ray.remote(_shoot)
    pending = {
        name: task.options(
            num_cpus=1, max_retries=0, runtime_env={"env_vars": worker_environment(catalog.find(name))}
        ).remote(own, films.get(name, []), folder.absolute(), dict(sources))
        for name, own in pictures.items()
    }
    troubles: list[str] = []
    for name, reference in pending.items():
        try:
            troubles += ray.get(reference)
        except RayError as error:
            troubles.append(f"{name} could not be filmed: {str(error).strip().splitlines()[-1]}")
    return troubles


def _shoot(
    looks: Sequence[Look], rows: Sequence[EpisodeResult], folder: Path, sources: Mapping[str, PolicySource]
) -> list[str]:
    troubles = [f"no picture: {line}" for line in picture(looks, folder)]
    rows = sorted(rows, key=lambda row: (row.task, row.policy))
    return troubles + [f"replay differs: {line}" for line in film(rows, folder, sources)]
