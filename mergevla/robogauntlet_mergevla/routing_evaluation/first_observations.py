"""Collects first observations of tasks, without a policy, in one process per simulator."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import AdapterError
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.ray_runtime.session import RayLost, ray_session
from robogauntlet.orchestrator.ray_runtime.simulator_processes import ProcessEnded, run_per_simulator
from robogauntlet.suites.episode import View
from robogauntlet_mergevla.routing.observation_cache import (
    ObservationCache,
    file_of,
    load_observations,
    save_observations,
)

SILENCE_S = 420.0
"""Time without a new observation after which a simulator's process is killed (s)."""
Listener = Callable[[str, int, int], None]
"""Called with the activity, the number of finished steps and the total."""


class FirstObservationError(Exception):
    """Tasks that cannot be observed; one line per problem."""


@dataclass(frozen=True)
class FirstObservations:
    """First observations, and the skipped simulators."""

    by_task: dict[str, ObservationCache]
    """Task to its first observations, which cover all seeds."""
    skipped: dict[str, str]
    """Simulator that is not installed here, to the reason."""


def collect_first_observations(
    tasks: Sequence[str], view: View, seeds: Sequence[int], folder: Path, listener: Listener
) -> FirstObservations:
    """Collect the first observation of each seed of each task, under the clean condition.

    A cached file in the folder is used if it has the same view and all seeds.

    Args:
        tasks: `simulator/task`.
        view: Cameras and image size.
        seeds: Seeds of the episodes.
        folder: The cache, with a file per task.
        listener: See `Listener`.

    Raises:
        FirstObservationError: A task is unknown, none of the simulators is installed, or one fails.
        RoutingError: A file in the folder is not a cache of observations.
        OSError: The folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    by_task: dict[str, ObservationCache] = {}
    missing: dict[str, list[str]] = {}
    for task in tasks:
        path = file_of(folder, task)
        cached = load_observations(path) if path.exists() else None
        if cached is not None and cached.task == task and cached.covers(view, seeds):
            by_task[task] = cached
        else:
            missing.setdefault(task.partition("/")[0], []).append(task)
    environments = EnvironmentResolver()
    try:
        reasons = {name: environments.missing_reason(catalog.find(name)) for name in missing}
    except AdapterError as error:
        raise FirstObservationError(str(error)) from None
    skipped = {name: reason for name, reason in reasons.items() if reason}
    observed = {name: its_tasks for name, its_tasks in missing.items() if name not in skipped}
    if observed:
        arguments = {name: (its_tasks, view, seeds, folder.resolve()) for name, its_tasks in observed.items()}
        total = sum(map(len, observed.values())) * len(seeds)
        try:
            with ray_session(address=None, workers=len(observed)):
                results = run_per_simulator(_save_observations, arguments, environments, silence_s=SILENCE_S)
                for done, (simulator, result) in enumerate(results, 1):
                    if isinstance(result, ProcessEnded):
                        raise FirstObservationError(f"{simulator}: {result.reason}")
                    listener("first observations", done, total)
        except RayLost as error:
            raise FirstObservationError(str(error)) from None
    by_task |= {task: load_observations(file_of(folder, task)) for task in chain(*observed.values())}
    if not by_task:
        raise FirstObservationError("\n".join(f"{name}: {reason}" for name, reason in skipped.items()))
    return FirstObservations({task: by_task[task] for task in tasks if task in by_task}, skipped)


def _save_observations(tasks: Sequence[str], view: View, seeds: Sequence[int], folder: Path) -> Iterator[None]:
    """Write a file per task; yield after each observation."""
    for task in tasks:
        simulation = catalog.open_simulation(task, view)
        observations = []
        for seed in seeds:
            simulation.reset(seed)
            observations.append(simulation.observe())
            yield
        simulation.close()
        save_observations(ObservationCache.of(task, view, seeds, observations), file_of(folder, task))
