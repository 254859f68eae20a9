"""What a worker does, without Ray: keeps a simulation open, keeps policies loaded, plays leases of episodes."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

from adapters import catalog as simulators
from adapters.contract import AdapterError, Simulation
from orchestrator.perturbations.references import ReferenceLooks
from orchestrator.rollout import Watcher, rollout
from orchestrator.sources import PolicySource, build
from policies.contract import Policy, PolicyError, check_fit
from results.record import EpisodeResult
from suites.vocabulary import Cell, Episode, View


@dataclass(frozen=True)
class Lease:
    """Episodes of one cell that one worker is to play, in order."""

    cell: Cell
    seeds: tuple[int, ...]
    attempt: int = 1
    """How often these episodes have been begun, this time included."""
    message_s: float = 0.1
    """Time after which results are sent, so that short episodes share a message."""

    def episodes(self) -> Iterator[Episode]:
        """The episodes, in order."""
        return map(self.cell.episode, self.seeds)


@dataclass(frozen=True)
class Readiness:
    """What a worker found when it opened its simulator."""

    pid: int
    render_device: str
    frame_s: float | None
    """Seconds for one observation of all cameras, once warm; None if the simulator draws nothing."""


class EpisodeRunner:
    """Plays episodes in this process, one at a time."""

    def __init__(
        self,
        sources: Mapping[str, PolicySource],
        worker: str = "local",
        elsewhere: Mapping[str, Policy] | None = None,
    ) -> None:
        """Prepare for episodes of these policies.

        Args:
            sources: Policy name to what it is built from.
            worker: Name written into the records.
            elsewhere: Policies that need not be built, since they compute in another process.
        """
        self._sources = sources
        self._worker = worker
        self._policies: dict[str, Policy] = dict(elsewhere or {})
        self._simulation: Simulation | None = None
        self._opened: tuple[str, View] | None = None
        self._references = ReferenceLooks()
        self._build_s = self._load_s = 0.0

    def prepare(self, task: str, view: View) -> Readiness:
        """Open a task and draw a frame, to learn whether this simulator works here.

        Raises:
            AdapterError: It does not; the message says why.
        """
        simulation = self._open(task, view)
        frame_s = None
        if simulators.find(task.partition("/")[0]).renders:
            simulation.observe()
            start = time.perf_counter()
            simulation.observe()
            frame_s = time.perf_counter() - start
        return Readiness(os.getpid(), simulation.render_device(), frame_s)

    def play(self, lease: Lease) -> Iterator[EpisodeResult]:
        """Play the lease's episodes. An episode that cannot be played yields an error record; nothing is raised."""
        for episode in lease.episodes():
            result = self.play_one(episode)
            yield replace(
                result, worker=self._worker, attempts=lease.attempt, build_s=self._build_s, load_s=self._load_s
            )
            self._build_s = self._load_s = 0.0

    def play_one(
        self, episode: Episode, watcher: Watcher | None = None, wrap: Callable[[Simulation], Simulation] | None = None
    ) -> EpisodeResult:
        """Play one episode. What a simulator raises is tried again in a fresh one, then recorded as error.

        Args:
            episode: What to play.
            watcher: Sees every step.
            wrap: Puts something of its own around the simulation, for this episode.
        """
        started, clock = time.time(), time.perf_counter()
        error = ""
        for _ in range(2):
            try:
                policy = self._policy(episode.policy)
                simulation = self._open(episode.task, episode.protocol.view)
                check_fit(policy.spec, simulation.action_spec, simulation.observation_spec)
                return rollout(
                    wrap(simulation) if wrap else simulation,
                    policy,
                    episode,
                    watcher=watcher,
                    references=self._references,
                )
            except (AdapterError, PolicyError) as known:
                error = f"{type(known).__name__}: {known}"
                break
            except Exception as unknown:  # simulators and policies raise anything; one episode must not end the rest
                error = _describe(unknown)
                self.close()
        return EpisodeResult.failed_to_run(episode, error, started_at=started, wall_s=time.perf_counter() - clock)

    def close(self) -> None:
        """Close the open simulation. The runner can go on afterwards."""
        simulation, self._simulation, self._opened = self._simulation, None, None
        if simulation is not None:
            simulation.close()

    def _open(self, task: str, view: View) -> Simulation:
        if self._simulation is None or self._opened != (task, view):
            self.close()
            start = time.perf_counter()
            for name, value in simulators.find(task.partition("/")[0]).environment.items():
                os.environ.setdefault(name, value)
            self._simulation = simulators.open_simulation(task, view)
            self._opened, self._references = (task, view), ReferenceLooks()
            self._build_s += time.perf_counter() - start
        return self._simulation

    def _policy(self, name: str) -> Policy:
        if name not in self._policies:
            start = time.perf_counter()
            self._policies[name] = build(self._sources[name])
            self._load_s += time.perf_counter() - start
        return self._policies[name]


def _describe(error: Exception) -> str:
    """Type, message and the innermost place of an exception, without anything that differs from run to run."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{os.path.basename(frame.filename)}:{frame.lineno}"  # noqa: PTH119
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0] if lines else '(no message)'} [{place}]"
