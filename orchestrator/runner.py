"""What a worker does, without Ray: keeps a simulation open, keeps policies loaded, plays leases of episodes."""

from __future__ import annotations

import os
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from adapters import catalog as simulators
from adapters.contract import AdapterError, Simulation, SimulationBatch
from orchestrator.lockstep import play_at_once
from orchestrator.perturbations.references import ReferenceLooks
from orchestrator.rollout import Watcher, rollout
from orchestrator.sources import PolicySource, build
from policies.contract import Policy, PolicyError, check_fit
from results.record import EpisodeResult
from suites.placement import Resources
from suites.vocabulary import Cell, Condition, Episode, View


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
    """Plays episodes in this process."""

    def __init__(
        self,
        sources: Mapping[str, PolicySource],
        worker: str = "local",
        elsewhere: Mapping[str, Policy] | None = None,
        resources: Resources | None = None,
    ) -> None:
        """Prepare for episodes of these policies.

        Args:
            sources: Policy name to what it is built from.
            worker: Name written into the records.
            elsewhere: Policies that need not be built, since they compute in another process.
            resources: Say how many episodes of a lease are played at once.
        """
        self._sources = sources
        self._worker = worker
        self._policies: dict[str, Policy] = dict(elsewhere or {})
        self._resources = resources or Resources()
        self._simulations: SimulationBatch | None = None
        self._opened: tuple[str, View, int] | None = None
        self._references = ReferenceLooks()
        self._build_s = self._load_s = 0.0

    def prepare(self, task: str, view: View) -> Readiness:
        """Open a task and draw a frame, to learn whether this simulator works here.

        Raises:
            AdapterError: It does not; the message says why.
        """
        simulations = self._open(task, view, self._resources.at_once)
        frame_s = None
        if simulators.find(task.partition("/")[0]).renders:
            simulations.members[0].reset(0, Condition())  # the contract promises nothing of a world that has not begun
            simulations.observe([0])
            start = time.perf_counter()
            simulations.observe([0])
            frame_s = time.perf_counter() - start
        return Readiness(os.getpid(), simulations.members[0].render_device(), frame_s)

    def play(self, lease: Lease) -> Iterator[EpisodeResult]:
        """Play the lease's episodes. An episode that cannot be played yields an error record; nothing is raised."""
        episodes = list(lease.episodes())
        results = self._play_at_once(episodes) if self._resources.at_once > 1 else map(self.play_one, episodes)
        for result in results:
            yield replace(
                result, worker=self._worker, attempts=lease.attempt, build_s=self._build_s, load_s=self._load_s
            )
            self._build_s = self._load_s = 0.0

    def _play_at_once(self, episodes: Sequence[Episode]) -> Iterator[EpisodeResult]:
        """Play episodes of one cell at once, in order of their beginning. What goes wrong is played again alone."""
        policy_name, view = episodes[0].policy, episodes[0].protocol.view
        done: dict[Episode, EpisodeResult] = {}
        try:
            policy = self._policy(policy_name)
            simulations = self._open(episodes[0].task, view, self._resources.at_once)
            check_fit(policy.spec, simulations.members[0].action_spec, simulations.members[0].observation_spec)
        except Exception:  # it will be met again, and told, by the first that is played alone
            yield from map(self.play_one, episodes)
            return
        waiting = deque(episodes)
        together = self._resources.ask_together
        for played in play_at_once(simulations, policy, episodes, self._rollout, ask_together=together):
            if isinstance(played.result, EpisodeResult):
                done[played.episode] = played.result
            while waiting and waiting[0] in done:
                yield done.pop(waiting.popleft())
        if waiting:
            self.close()
        for episode in waiting:
            yield done[episode] if episode in done else self.play_one(episode)

    def _rollout(
        self, simulation: Simulation, policy: Policy, episode: Episode, clock: Callable[[], float]
    ) -> EpisodeResult:
        return rollout(simulation, policy, episode, references=self._references, clock=clock)

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
                simulation = self._open(episode.task, episode.protocol.view, 1).members[0]
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
        """Close the open simulations. The runner can go on afterwards."""
        simulations, self._simulations, self._opened = self._simulations, None, None
        if simulations is not None:
            simulations.close()

    def _open(self, task: str, view: View, count: int) -> SimulationBatch:
        if self._simulations is None or self._opened != (task, view, count):
            self.close()
            start = time.perf_counter()
            for name, value in simulators.find(task.partition("/")[0]).environment.items():
                os.environ.setdefault(name, value)
            self._simulations = simulators.open_batch(task, view, count)
            self._opened, self._references = (task, view, count), ReferenceLooks()
            self._build_s += time.perf_counter() - start
        return self._simulations

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
