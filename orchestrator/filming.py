"""Films chosen episodes of a finished run, a Ray task per simulator."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import ray
from ray.exceptions import RayError

from adapters import catalog
from orchestrator.replay import choose_for_media, film
from orchestrator.runner import PolicySource
from orchestrator.worker_environment import worker_environment
from results.record import EpisodeResult


def film_run(folder: Path, rows: Iterable[EpisodeResult], sources: Mapping[str, PolicySource]) -> list[str]:
    """Film a success and a failure of each policy on each task, within the run folder.

    Returns:
        A line for each episode that came out differently than its row, and for each simulator that failed.
    """
    by_simulator: dict[str, list[EpisodeResult]] = {}
    for row in choose_for_media(rows):
        by_simulator.setdefault(row.simulator, []).append(row)
    task: Any = ray.remote(film)
    pending = {
        name: task.options(
            num_cpus=1, max_retries=0, runtime_env={"env_vars": worker_environment(catalog.find(name))}
        ).remote(chosen, folder.absolute(), dict(sources))
        for name, chosen in by_simulator.items()
    }
    troubles: list[str] = []
    for name, reference in pending.items():
        try:
            troubles += [f"replay differs: {line}" for line in ray.get(reference)]
        except RayError as error:
            troubles.append(f"{name} could not be filmed: {str(error).strip().splitlines()[-1]}")
    return troubles
