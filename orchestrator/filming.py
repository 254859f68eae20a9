"""Films chosen episodes of a finished run and pictures its conditions, a Ray task per simulator."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

from orchestrator.beside import Ended, beside
from orchestrator.choosing import Look, fallen, typical
from orchestrator.environments.homes import Homes
from orchestrator.looking import picture
from orchestrator.replay import film
from orchestrator.sources import PolicySource
from results.media import look_path, video_path
from results.record import EpisodeResult


@dataclass
class Shots:
    """What is to be filmed and pictured in one simulator."""

    films: list[EpisodeResult] = field(default_factory=list)
    looks: list[Look] = field(default_factory=list)

    @property
    def count(self) -> int:
        """How much there is to do."""
        return len(self.films) + len(self.looks)


@dataclass(frozen=True)
class Shot:
    """What came of filming an episode or taking a look, on whatever node."""

    files: Mapping[Path, bytes]
    """Path in the run folder to what it is to hold."""
    trouble: str | None
    """What is wrong with it, in a line."""


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


def film_run(
    folder: Path,
    shots: Mapping[str, Shots],
    sources: Mapping[str, PolicySource],
    listener: Callable[[], None] = lambda: None,
    homes: Homes | None = None,
) -> list[str]:
    """Film and picture, a process per simulator beside each other. Ray must be running.

    What was shot comes back to this process, which alone writes into the run folder: the others may be on nodes that
    do not see it.

    Args:
        folder: Of the run.
        shots: See `to_shoot`.
        sources: The run's policies.
        listener: Told after every episode that was filmed and every look that was taken.
        homes: In which environment each simulator runs.

    Returns:
        A line for each episode that came out differently than its row, for each look that could not be had, and for
        each simulator that failed.

    Raises:
        RayLost: Ray itself has died. What came back before is there.
        OSError: The folder cannot be written.
    """
    troubles: list[str] = []
    for simulator, came in beside(_shoot, {name: (own, dict(sources)) for name, own in shots.items()}, homes):
        if isinstance(came, Ended):
            troubles.append(f"{simulator} could not be filmed: {came.reason}")
            continue
        for path, content in came.files.items():
            _keep(folder / path, content)
        if came.trouble is not None:
            troubles.append(came.trouble)
        listener()
    return troubles


def _keep(path: Path, content: bytes) -> None:
    """Write a file, complete under its name or not there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.partial")
    partial.write_bytes(content)
    partial.replace(path)


def _shoot(shots: Shots, sources: Mapping[str, PolicySource]) -> Iterator[Shot]:
    with tempfile.TemporaryDirectory(prefix="robogauntlet-") as name:
        folder = Path(name)
        rows = sorted(shots.films, key=lambda row: (row.task, row.policy))
        for made in chain(picture(shots.looks, folder), film(rows, folder, sources)):
            yield Shot({path.relative_to(folder): path.read_bytes() for path in made.files}, made.trouble)
